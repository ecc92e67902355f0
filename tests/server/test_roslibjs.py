"""roslibjs 1 and 2 as clients of the server; skipped where node or the libraries are not there.

``npm ci --prefix tests/js`` installs them.
"""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.qos import LATCHED, QoS
from tests.contract.conftest import Inbox, until
from tests.server.conftest import Place
from tests.server.peers import Peers, peers

PROGRAM = Path(__file__).parents[1] / "js" / "client.mjs"
NODE = shutil.which("node")
if NODE is None:
    pytest.skip("needs node", allow_module_level=True)
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
        for number in range(60):
            publisher.publish(sample(place, STRING, {"data": f"n{number}"}))
            await asyncio.sleep(0.01)
        await program.wait(lambda: program.heard("/fast")[-1:] == [{"data": "n59"}])
        assert 3 <= len(program.heard("/fast")) <= 6


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
