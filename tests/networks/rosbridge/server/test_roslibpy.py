"""roslibpy, over both of its transports, as a client of the server."""

from __future__ import annotations

import asyncio
import base64
import importlib.util
import json
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from ropeway import aio
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.graph.calls import ActionHandlers, Outcome, Request, ServerGoal
from ropeway.qos import LATCHED, QoS
from tests.networks.rosbridge.server.peers import Peers, peers
from tests.support.actions import FIBONACCI, Worker, count, ordered
from tests.support.inbox import Inbox
from tests.support.place import Place
from tests.support.services import ADD, add, addends, total
from tests.support.until import PATIENCE_S, until

if importlib.util.find_spec("roslibpy") is None:
    pytest.skip("needs roslibpy, which make test installs", allow_module_level=True)

PROGRAM = Path(__file__).with_name("roslibpy_client.py")
STRING, IMAGE, IMU = "std_msgs/msg/String", "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu"
JOINTS = "sensor_msgs/msg/JointState"
HEADER = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "cam"}
SENT: dict[str, dict[str, Any]] = {
    "std_msgs/String": {"data": "grüße \u2603"},
    IMAGE: {"header": HEADER, "height": 2, "width": 2, "step": 2, "data": base64.b64encode(b"\0\1\xfe\xff").decode()},
    JOINTS: {"header": HEADER, "name": ["a", "b"], "position": [0.5, -1.0], "velocity": [], "effort": []},
}

Run = Callable[..., AbstractAsyncContextManager[Peers]]


@pytest.fixture(params=["twisted", "asyncio"])
def run(request: pytest.FixtureRequest, place: Place) -> Run:
    """Runs clients of the place's server."""

    @asynccontextmanager
    async def start(plan: dict[str, Any]) -> AsyncIterator[Peers]:
        async with peers(sys.executable, str(PROGRAM), request.param, str(place.port), plan=plan) as program:
            await program.connected(plan.get("clients", 1))
            yield program

    return start


def sample(place: Place, type: str, message: dict[str, Any]) -> Sample:
    """A message for the robot to publish."""
    return Sample(place.registry.codec(type).from_json(message), type, 0, bytes(16), SEQ_NONE)


async def test_publish(run: Run, place: Place) -> None:
    """What roslibpy publishes arrives whole, with long and short names of types."""
    inboxes = {type: Inbox() for type in SENT}
    items = []
    for number, (type, message) in enumerate(SENT.items()):
        await place.robot.create_subscription(f"/t{number}", place.registry.canonical(type), QoS(), inboxes[type])
        items.append({"name": f"/t{number}", "type": type, "message": message})
    async with run({"publish": items}) as program:
        program.publish()
        for type, inbox in inboxes.items():
            await inbox.wait(1)
            assert json.loads(place.registry.codec(type).json(inbox.payloads[0])).items() >= SENT[type].items()
    assert place.complaints == {}


async def test_subscribe(run: Run, place: Place) -> None:
    """What the robot publishes arrives as JSON: bytes as base64, what is no number as null, long integers whole."""
    messages = {
        **{place.registry.canonical(type): message for type, message in SENT.items()},
        IMU: {"header": HEADER, "orientation_covariance": [None, *[0.5] * 8]},
        "std_msgs/msg/Int64": {"data": 2**63 - 1},
    }
    items = [{"name": f"/t{n}", "type": type} for n, type in enumerate(messages)]
    publishers = [await place.robot.create_publisher(f"/t{n}", type, LATCHED) for n, type in enumerate(messages)]
    for publisher, (type, message) in zip(publishers, messages.items(), strict=True):
        publisher.publish(sample(place, type, message))
    async with run({"subscribe": items}) as program:
        for number, message in enumerate(messages.values()):
            await program.wait(lambda topic=f"/t{number}": program.heard(topic))
            (got,) = program.heard(f"/t{number}")
            assert got.items() >= message.items()


async def test_one_client_to_another(run: Run) -> None:
    """One client hears what another publishes, and what it publishes itself."""
    plan = {
        "clients": 2,
        "subscribe": [{"name": "/chat", "type": "std_msgs/String"}],
        "publish": [{"name": "/chat", "type": "std_msgs/String", "message": {"data": "hello"}, "client": 0}],
    }
    async with run(plan) as program:
        await asyncio.sleep(0.2)
        program.publish()
        for client in (0, 1):
            await program.wait(lambda client=client: program.heard("/chat", client))
            assert program.heard("/chat", client) == [{"data": "hello"}]


async def test_latch(run: Run, place: Place) -> None:
    """What is published with latch reaches those who come later."""
    item = {"name": "/map", "type": STRING, "latch": True, "message": {"data": "kept"}}
    async with run({"publish": [item]}) as program:
        program.publish()
        await until(lambda: "/map" in place.robot.topics())
        await asyncio.sleep(1.2)  # the server's default forgets after 1 s
        inbox = Inbox()
        await place.robot.create_subscription("/map", STRING, LATCHED, inbox)
        await inbox.wait(1)


async def test_throttle(run: Run, place: Place) -> None:
    """With a throttle rate, messages come no more often."""
    publisher = await place.robot.create_publisher("/fast", STRING, QoS(depth=100))
    plan = {"subscribe": [{"name": "/fast", "type": STRING, "throttle_rate": 200, "queue_length": 1}]}
    async with run(plan) as program:
        await until(lambda: publisher.subscribers == 1)
        began = time.monotonic()
        for number in range(60):
            publisher.publish(sample(place, STRING, {"data": str(number)}))
            await asyncio.sleep(0.01)
        await program.wait(lambda: program.heard("/fast")[-1:] == [{"data": "59"}])
        heard = len(program.heard("/fast"))
        assert heard >= 3
        assert (heard - 2) * 0.2 <= time.monotonic() - began  # however long the busy machine took


async def test_thirty_clients(run: Run, place: Place) -> None:
    """Thirty clients at once each hear everything and are each heard."""
    publisher = await place.robot.create_publisher("/all", STRING, QoS(depth=100))
    inboxes = [Inbox() for _ in range(30)]
    for number, inbox in enumerate(inboxes):
        await place.robot.create_subscription(f"/from{number}", STRING, QoS(depth=100), inbox)
    plan = {
        "clients": 30,
        "subscribe": [{"name": "/all", "type": STRING}],
        "publish": [{"name": "/from#", "type": STRING, "message": {"data": "here"}}],
    }
    async with run(plan) as program:
        await until(lambda: sum(len(s.outputs) for s in place.server.sessions) == 30 and publisher.subscribers)
        for number in range(10):
            publisher.publish(sample(place, STRING, {"data": str(number)}))
        program.publish()
        wanted = [{"data": str(number)} for number in range(10)]
        await program.wait(lambda: len(program.heard("/all")) == 300, 40)
        assert all(program.heard("/all", client) == wanted for client in range(30))
        for inbox in inboxes:
            await inbox.wait(1, 30)
    await until(lambda: not place.server.sessions)
    assert publisher.subscribers == 0


async def test_reconnect(run: Run, place: Place) -> None:
    """After a restart of the server the library comes back, and data flows both ways again."""
    publisher = await place.robot.create_publisher("/down", STRING, QoS())
    inbox = Inbox()
    await place.robot.create_subscription("/up", STRING, QoS(), inbox)
    plan = {
        "subscribe": [{"name": "/down", "type": STRING}],
        "publish": [{"name": "/up", "type": STRING, "message": {"data": "up"}}],
    }
    async with run(plan) as program:
        await until(lambda: publisher.subscribers == 1)
        await place.server.close()
        await program.wait(lambda: any("closed" in s for s in program.said))
        await place.server.listen(f"ws://127.0.0.1:{place.port}")
        await until(lambda: publisher.subscribers == 1)
        publisher.publish(sample(place, STRING, {"data": "again"}))
        await program.wait(lambda: program.heard("/down"))
        async with aio.timeout(PATIENCE_S):
            while not inbox.samples:
                program.publish()
                await asyncio.sleep(0.1)


async def test_calls(run: Run, place: Place) -> None:
    """A service of the robot answers with its response, and its failures arrive as the texts they are."""
    await place.robot.create_service("/add", ADD, add)
    async with run({}) as program:
        program.do(call="/add", type=ADD, args={"a": 2**62, "b": 1})
        assert (await program.told(answered="/add"))[0]["values"] == {"sum": 2**62 + 1}
        program.do(call="/nobody", type=ADD)
        assert (await program.told(failed="/nobody"))[0]["text"] == "Service /nobody does not exist"
        program.do(call="/add", type=ADD, args={"c": 1})
        failed = await program.told(failed="/add")
        assert failed[0]["text"] == "Message type example_interfaces/AddTwoInts_Request does not have a field c"
    assert place.complaints == {}


async def test_serves(run: Run, place: Place) -> None:
    """The robot and other clients call a service of a client; its response counts, whatever the client returns."""
    serve = [
        {"name": "/add", "type": "example_interfaces/AddTwoInts", "values": {"sum": 5}, "client": 0},
        {"name": "/fail", "type": ADD, "values": {"sum": 7}, "fail": True, "client": 0},
    ]
    async with run({"clients": 2, "serve": serve}) as program:
        client = await place.robot.create_client("/add", ADD)
        assert await client.wait_available(PATIENCE_S)
        assert await client.call(Request(addends(2, 3))) == total(5)
        assert (await program.told(asked="/add"))[0]["args"] == {"a": 2, "b": 3}
        for name, sum in (("/add", 5), ("/fail", 7)):
            program.do(call=name, type=ADD, client=1)
            assert (await program.told(answered=name, client=1))[0]["values"] == {"sum": sum}
    await until(lambda: not place.server.sessions)
    assert not place.robot.services()["/add"].servers


async def test_rosapi(run: Run, place: Place) -> None:
    """The library's own questions are answered."""
    await place.robot.create_publisher("/image", IMAGE, QoS())
    await place.robot.create_service("/add", ADD, add)
    async with run({}) as program:
        answers = {}
        for ask, args in [
            ("get_topics", []),
            ("get_topic_type", ["/image"]),
            ("get_services", []),
            ("get_service_type", ["/add"]),
            ("get_nodes", []),
        ]:
            program.do(ask=ask, args=args)
            answers[ask] = (await program.told(answered=ask))[0]["values"]
        assert "/image" in answers["get_topics"]["topics"]
        assert answers["get_topic_type"] == {"type": IMAGE}
        assert "/add" in answers["get_services"]["services"]
        assert answers["get_service_type"] == {"type": ADD}
        assert "/robot" in answers["get_nodes"]["nodes"]
    assert place.complaints == {}


async def test_goals(run: Run, place: Place) -> None:
    """Goals for the robot have feedback and results, may be cancelled, and fail with a text if nobody takes them."""
    worker = Worker()

    async def execute(goal: ServerGoal) -> Outcome:
        return await (worker(goal) if ordered(goal) > 100 else count(goal))

    await place.robot.create_action_server("/fib", FIBONACCI, ActionHandlers(execute))
    async with run({}) as program:
        program.do(goal="/fib", type=FIBONACCI, args={"order": 3})
        result = (await program.told(result="/fib"))[0]["values"]
        assert result["values"] == {"sequence": [0, 1, 2]}
        assert [s["values"]["sequence"] for s in await program.told(3, feedback="/fib")] == [[0], [0, 1], [0, 1, 2]]
        program.do(goal="/nobody", type=FIBONACCI, args={"order": 3})
        assert "No action server available" in (await program.told(failed="/nobody"))[0]["text"]
        program.do(goal="/fib", type=FIBONACCI, args={"order": 101})
        (_, sent) = await program.told(2, sent="/fib")
        await until(lambda: worker.goals)
        program.do(cancel="/fib", id=sent["id"])
        cancelled = (await program.told(2, result="/fib"))[1]["values"]
        assert cancelled["values"] == {"sequence": [5]}
        assert cancelled["status"] == "CANCELED"
    assert place.complaints == {}
