"""roslibjs 1 and 2 as clients of the server; skipped where node or the libraries are not there.

``npm ci --prefix tests/js`` installs them.
"""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from ropeway.errors import CallFailed
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.qos import LATCHED, QoS
from tests.networks.rosbridge.server.peers import Peers, peers
from tests.support.actions import FIBONACCI, Worker, count, order, ordered, sequence
from tests.support.inbox import Inbox
from tests.support.place import Place
from tests.support.services import ADD, add, addends, total
from tests.support.until import PATIENCE_S, until

PROGRAM = Path(__file__).parents[3] / "js" / "client.mjs"
NODE = shutil.which("node")
if NODE is None:
    pytest.skip("needs Node.js, which .ci/run installs on Debian", allow_module_level=True)
if not (PROGRAM.parent / "node_modules").is_dir():
    pytest.skip("needs roslibjs: npm ci --prefix tests/js", allow_module_level=True)

STRING, IMAGE, SCAN = "std_msgs/msg/String", "sensor_msgs/msg/Image", "sensor_msgs/msg/LaserScan"
IMU, JOINTS, LAYOUT = "sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState", "std_msgs/msg/Int64MultiArray"
HEADER = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "cam"}
PIXELS = bytes(range(256)) * 3
COMPRESSIONS = ("none", "png", "cbor", "cbor-raw")

MESSAGES: dict[str, dict[str, Any]] = {
    STRING: {"data": "grüße \u2603"},
    IMAGE: {"header": HEADER, "height": 16, "width": 16, "step": 48, "data": base64.b64encode(PIXELS).decode()},
    SCAN: {"header": HEADER, "ranges": [0.5, 1.25, -2.0], "intensities": []},
    IMU: {"header": HEADER, "orientation_covariance": [0.5, *[0.0] * 8]},
    JOINTS: {"header": HEADER, "name": ["a", "b"], "position": [0.5, -1.0]},
    LAYOUT: {"data": [1, -2, 2**40]},
}

Run = Callable[..., AbstractAsyncContextManager[Peers]]


@pytest.fixture(params=["roslib1", "roslib2"])
def run(request: pytest.FixtureRequest, place: Place) -> Run:
    """Runs clients of the place's server."""

    @asynccontextmanager
    async def start(plan: dict[str, Any]) -> AsyncIterator[Peers]:
        assert NODE is not None
        async with peers(NODE, str(PROGRAM), request.param, str(place.port), plan=plan) as program:
            await program.connected(plan.get("clients", 1))
            yield program

    return start


def sample(place: Place, type: str, message: dict[str, Any]) -> Sample:
    """A message for the robot to publish."""
    return Sample(place.registry.codec(type).from_json(message), type, 0, bytes(16), SEQ_NONE)


def plain(value: Any) -> Any:
    """A message as JSON would have it: typed arrays are lists, bytes are base64, long integers numbers."""
    if isinstance(value, dict):
        if value.keys() == {"kind", "values"}:
            numbers = value["values"]
            as_bytes = value["kind"] in ("Uint8Array", "Buffer")
            return base64.b64encode(bytes(numbers)).decode() if as_bytes else [plain(n) for n in numbers]
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return int(value) if isinstance(value, str) and value.lstrip("-").isdecimal() else value


async def test_publish(run: Run, place: Place) -> None:
    """What roslibjs publishes arrives whole."""
    inboxes = {type: Inbox() for type in MESSAGES}
    items = []
    for number, (type, message) in enumerate(MESSAGES.items()):
        await place.robot.create_subscription(f"/t{number}", type, QoS(), inboxes[type])
        items.append({"name": f"/t{number}", "type": type.replace("/msg/", "/"), "message": message})
    async with run({"publish": items}) as program:
        program.publish()
        for type, inbox in inboxes.items():
            await inbox.wait(1)
            assert inbox.payloads == [sample(place, type, MESSAGES[type]).payload]
    assert place.complaints == {}


@pytest.mark.parametrize("compression", COMPRESSIONS)
async def test_subscribe(run: Run, place: Place, compression: str) -> None:
    """What the robot publishes arrives in every compression."""
    items = [{"name": f"/t{n}", "type": type, "compression": compression} for n, type in enumerate(MESSAGES)]
    publishers = [await place.robot.create_publisher(f"/t{n}", type, LATCHED) for n, type in enumerate(MESSAGES)]
    samples = [sample(place, type, message) for type, message in MESSAGES.items()]
    for publisher, message in zip(publishers, samples, strict=True):
        publisher.publish(message)
    async with run({"subscribe": items}) as program:
        for number, (type, message) in enumerate(zip(MESSAGES, samples, strict=True)):
            await program.wait(lambda topic=f"/t{number}": program.heard(topic))
            (got,) = program.heard(f"/t{number}")
            if compression == "cbor-raw":
                assert bytes(got["bytes"]["values"]) == message.payload
            else:
                assert plain(got) == json.loads(place.registry.codec(type).json(message.payload))


async def test_typed_arrays(run: Run, place: Place) -> None:
    """In cbor, sequences of numbers arrive as typed arrays."""
    publisher = await place.robot.create_publisher("/scan", SCAN, LATCHED)
    publisher.publish(sample(place, SCAN, MESSAGES[SCAN]))
    async with run({"subscribe": [{"name": "/scan", "type": SCAN, "compression": "cbor"}]}) as program:
        await program.wait(lambda: program.heard("/scan"))
        (got,) = program.heard("/scan")
        assert got["ranges"] == {"kind": "Float32Array", "values": [0.5, 1.25, -2.0]}


async def test_compressions_side_by_side(run: Run, place: Place) -> None:
    """Clients of one topic have each their own compression."""
    publisher = await place.robot.create_publisher("/image", IMAGE, QoS(depth=10))
    items = [{"name": "/image", "type": IMAGE, "compression": c, "client": n} for n, c in enumerate(COMPRESSIONS)]
    message = sample(place, IMAGE, MESSAGES[IMAGE])
    async with run({"clients": 4, "subscribe": items}) as program:
        await until(lambda: sum(len(s.outputs) for s in place.server.sessions) == 4)
        for _ in range(5):
            publisher.publish(message)
        await program.wait(lambda: len(program.heard("/image")) == 20)
        wanted = json.loads(place.registry.codec(IMAGE).json(message.payload))
        for client in range(3):
            assert [plain(got) for got in program.heard("/image", client)] == [wanted] * 5
        assert [bytes(got["bytes"]["values"]) for got in program.heard("/image", 3)] == [message.payload] * 5


async def test_throttle(run: Run, place: Place) -> None:
    """With a throttle rate, messages come no more often."""
    publisher = await place.robot.create_publisher("/fast", STRING, QoS(depth=100))
    plan = {"subscribe": [{"name": "/fast", "type": STRING, "throttle_rate": 200, "queue_length": 1}]}
    async with run(plan) as program:
        await until(lambda: publisher.subscribers == 1)
        began = time.monotonic()
        for number in range(60):
            publisher.publish(sample(place, STRING, {"data": f"n{number}"}))
            await asyncio.sleep(0.01)
        await program.wait(lambda: program.heard("/fast")[-1:] == [{"data": "n59"}])
        heard = len(program.heard("/fast"))
        assert heard >= 3
        assert (heard - 2) * 0.2 <= time.monotonic() - began  # however long the busy machine took


async def test_calls(run: Run, place: Place) -> None:
    """A service of the robot answers with its response, and its failures arrive as the texts they are."""

    async def divide(request: Request) -> bytes:
        if request.payload == addends(0, 0):
            raise CallFailed("/divide", "there is nothing to divide")
        return await add(request)

    await place.robot.create_service("/divide", ADD, divide)
    async with run({}) as program:
        program.do(call="/divide", type="example_interfaces/AddTwoInts", args={"a": 2**31, "b": 1})
        assert (await program.told(answered="/divide"))[0]["values"] == {"sum": 2**31 + 1}
        program.do(call="/divide", type=ADD)
        assert (await program.told(failed="/divide"))[0]["text"] == "there is nothing to divide"
        program.do(call="nobody", type=ADD)
        assert (await program.told(failed="nobody"))[0]["text"] == "Service /nobody does not exist"
        program.do(call="/divide", type=ADD, args={"c": 1})
        failed = await program.told(2, failed="/divide")
        assert failed[1]["text"] == "Message type example_interfaces/AddTwoInts_Request does not have a field c"
    assert place.complaints == {}


async def test_serves(run: Run, place: Place) -> None:
    """The robot and other clients call a service of a client."""
    serve = [{"name": "/add", "type": "example_interfaces/AddTwoInts", "values": {"sum": 5}, "client": 0}]
    async with run({"clients": 2, "serve": serve}) as program:
        client = await place.robot.create_client("/add", ADD)
        assert await client.wait_available(PATIENCE_S)
        assert await client.call(Request(addends(2, 3))) == total(5)
        assert (await program.told(asked="/add"))[0]["args"] == {"a": 2, "b": 3}
        program.do(call="/add", type=ADD, args={"a": 1}, client=1)
        assert (await program.told(answered="/add", client=1))[0]["values"] == {"sum": 5}
    await until(lambda: not place.server.sessions)
    assert not place.robot.services()["/add"].servers


@pytest.mark.parametrize("run", ["roslib2"], indirect=True)  # the first version lets the error through
async def test_throws(run: Run, place: Place) -> None:
    """A service of a client that throws fails the call at once."""
    serve = [{"name": "/throws", "type": ADD, "fail": "no hands"}]
    async with run({"serve": serve}) as program:
        await until(lambda: "/throws" in place.robot.services())
        caller = await place.client()
        caller.send({"op": "call_service", "service": "/throws", "timeout": 0})
        got = await caller.json(5)
        assert (got["values"], got["result"]) == ("/throws failed, and does not say why", False)
        await program.told(asked="/throws")


async def test_rosapi(run: Run, place: Place) -> None:
    """The library's own questions are answered: topics, types, services, nodes, the time."""
    await place.robot.create_publisher("/scan", SCAN, QoS())
    await place.robot.create_service("/add", ADD, add)
    async with run({}) as program:
        answers = {}
        for ask, args in [
            ("getTopics", []),
            ("getTopicsForType", [SCAN]),
            ("getTopicType", ["/scan"]),
            ("getServices", []),
            ("getServicesForType", [ADD]),
            ("getServiceType", ["/add"]),
            ("getServiceRequestDetails", [ADD]),
            ("getNodes", []),
            ("getMessageDetails", ["geometry_msgs/Point"]),
            ("getTopicsAndRawTypes", []),
        ]:
            program.do(ask=ask, args=args)
            answers[ask] = (await program.told(answered=ask))[0]["values"]
        topics = answers["getTopics"]
        assert dict(zip(topics["topics"], topics["types"], strict=True))["/scan"] == SCAN
        assert answers["getTopicsForType"] == ["/scan"]
        assert answers["getTopicType"] == SCAN
        assert "/add" in answers["getServices"]
        assert answers["getServicesForType"] == ["/add"]
        assert answers["getServiceType"] == ADD
        assert answers["getServiceRequestDetails"]["typedefs"][0]["fieldnames"] == ["a", "b"]
        assert "/robot" in answers["getNodes"]
        assert answers["getMessageDetails"][0]["fieldtypes"] == ["double"] * 3
        assert "float32 angle_min" in "".join(answers["getTopicsAndRawTypes"]["typedefs_full_text"])
    assert place.complaints == {}


@pytest.mark.parametrize("run", ["roslib2"], indirect=True)  # the first version has no actions of ROS 2
async def test_goals(run: Run, place: Place) -> None:
    """Goals for the robot have feedback and results; some fail, some are cancelled, by their ids or all at once."""
    worker = Worker()

    async def execute(goal: ServerGoal) -> Outcome:
        if ordered(goal) > 100:
            return await worker(goal)
        return await count(goal)

    await place.robot.create_action_server("/fib", FIBONACCI, ActionHandlers(execute))
    async with run({}) as program:
        program.do(goal="/fib", type="example_interfaces/Fibonacci", args={"order": 3})
        assert (await program.told(result="/fib"))[0]["values"] == {"sequence": [0, 1, 2]}
        assert [s["values"]["sequence"] for s in await program.told(3, feedback="/fib")] == [[0], [0, 1], [0, 1, 2]]
        program.do(goal="/fib", type=FIBONACCI, args={"order": "x"})
        await program.told(failed="/fib")
        program.do(goal="/nobody", type=FIBONACCI, args={"order": 1})
        assert "No action server available" in (await program.told(failed="/nobody"))[0]["text"]
        program.do(goal="/fib", type=FIBONACCI, args={"order": 101})
        (_, _, sent) = await program.told(3, sent="/fib")
        await until(lambda: worker.goals)
        program.do(cancel="/fib", type=FIBONACCI, id=sent["id"])
        await program.told(2, failed="/fib")
        program.do(goal="/fib", type=FIBONACCI, args={"order": 101})
        await until(lambda: len(worker.goals) == 2)
        program.do(cancel="/fib", type=FIBONACCI)
        await program.told(3, failed="/fib")
    assert place.complaints == {}


@pytest.mark.parametrize("run", ["roslib2"], indirect=True)
async def test_carries_out(run: Run, place: Place) -> None:
    """A client carries out the goals of the robot and of other clients."""
    plan = {"clients": 2, "act": [{"name": "/fib", "type": "example_interfaces/Fibonacci", "client": 0}]}
    async with run(plan) as program:
        client = await place.robot.create_action_client("/fib", FIBONACCI)
        assert await client.wait_available(PATIENCE_S)
        feedback: list[bytes] = []
        goal = await client.send_goal(Goal(order(2)), on_feedback=feedback.append)
        assert await goal.result(PATIENCE_S) == Outcome(GoalStatus.SUCCEEDED, sequence(0, 1))
        assert feedback == [sequence(0), sequence(0, 1)]
        goal = await client.send_goal(Goal(order(-1)))
        assert (await goal.result(PATIENCE_S)).status == GoalStatus.ABORTED
        goal = await client.send_goal(Goal(order(101)))
        await program.told(3, asked="/fib")
        assert await goal.cancel()
        assert await goal.result(PATIENCE_S) == Outcome(GoalStatus.CANCELED, sequence(5))
        program.do(goal="/fib", type=FIBONACCI, args={"order": 1}, client=1)
        assert (await program.told(result="/fib", client=1))[0]["values"] == {"sequence": [0]}


async def test_thirty_clients(run: Run, place: Place) -> None:
    """Thirty clients at once each hear everything and are each heard."""
    publisher = await place.robot.create_publisher("/all", STRING, QoS(depth=100))
    inboxes = [Inbox() for _ in range(30)]
    for number, inbox in enumerate(inboxes):
        await place.robot.create_subscription(f"/from{number}", STRING, QoS(depth=100), inbox)
    plan = {
        "clients": 30,
        "subscribe": [
            {"name": "/all", "type": STRING, "compression": COMPRESSIONS[n % 3], "client": n} for n in range(30)
        ],
        "publish": [{"name": "/from#", "type": STRING, "message": {"data": "here"}}],
    }
    async with run(plan) as program:
        await until(lambda: sum(len(s.outputs) for s in place.server.sessions) == 30)
        for number in range(10):
            publisher.publish(sample(place, STRING, {"data": f"n{number}"}))
        program.publish()
        await program.wait(lambda: len(program.heard("/all")) == 300)
        wanted = [{"data": f"n{number}"} for number in range(10)]
        for client in range(30):  # a client may unpack a later PNG sooner
            assert sorted(program.heard("/all", client), key=str) == sorted(wanted, key=str)
        for inbox in inboxes:
            await inbox.wait(1)
    await until(lambda: not place.server.sessions)
    assert publisher.subscribers == 0


async def test_thirty_callers(run: Run, place: Place) -> None:
    """Thirty clients each serve one service and call that of another, at once."""
    serve = [{"name": f"/add{n}", "type": ADD, "values": {"sum": n}, "client": n} for n in range(30)]
    async with run({"clients": 30, "serve": serve}) as program:
        await until(lambda: sum(len(s.services.offered) for s in place.server.sessions) == 30)
        for number in range(30):
            program.do(call=f"/add{number}", type=ADD, args={"a": 1}, client=(number + 1) % 30)
        await program.wait(lambda: sum("answered" in s for s in program.said) == 30)
        assert {s["answered"]: s["values"]["sum"] for s in program.said if "answered" in s} == {
            f"/add{n}": n for n in range(30)
        }
