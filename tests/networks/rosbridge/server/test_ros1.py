"""The server on a network of ROS 1: its clients get what ROS 1's rosbridge says."""

from __future__ import annotations

import json
from typing import Any

import cbor2
import pytest

from ropeway.hub.hub import Hub
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.server.server import RosbridgeServer
from ropeway.qos import LATCHED
from ropeway.types.ros1_spelling import Ros1Spelling
from ropeway.types.ros1_types import Ros1Types
from tests.support.messages import sample
from tests.support.place import Place
from tests.support.rosbridge import REGISTRY
from tests.support.until import until

pytestmark = pytest.mark.jumping

SPELLING = Ros1Spelling(Ros1Types(REGISTRY))


class Ros1Network(MemoryGraph):
    """A network in memory that says that it is one of ROS 1."""

    ros1_spelling = SPELLING


@pytest.fixture
async def ros1(bare: Place) -> Place:
    """A server on such a network."""
    graph = Ros1Network(bare.network, node="/gateway")
    await graph.open()
    bare.stack.push_async_callback(graph.close)
    bare.robot = await bare.participant("/robot")
    bare.hub = Hub(graph)
    bare.server = RosbridgeServer(bare.hub, REGISTRY)
    bare.stack.push_async_callback(bare.server.close)
    bare.port = (await bare.server.listen("ws://127.0.0.1:0")).port
    return bare


async def publisher(place: Place, topic: str, type: str, value: dict[str, Any]) -> None:
    """The robot publishes one message, latched."""
    made = await place.robot.create_publisher(topic, type, LATCHED)
    one = sample("")
    one.payload, one.type = REGISTRY.codec(type).encode(value), type
    made.publish(one)


@pytest.mark.parametrize(
    ("type", "msg", "kept"),
    [
        (
            "geometry_msgs/PoseStamped",
            {"header": {"seq": 1, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "map"}},
            {"header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "map"}},
        ),
        ("sensor_msgs/CameraInfo", {"header": {"stamp": {}}, "D": [0.1]}, {"d": [0.1]}),
        ("std_msgs/Byte", {"data": -5}, {"data": 251}),
        ("std_msgs/Time", {"data": {"secs": 4000000000, "nsecs": 0}}, {"data": {"sec": -294967296}}),
    ],
)
async def test_publishing(ros1: Place, type: str, msg: dict[str, Any], kept: dict[str, Any]) -> None:
    """What clients of ROS 1 publish is taken as they spell it, in JSON and as raw bytes."""
    got: list[Any] = []
    full = REGISTRY.canonical(type)
    await ros1.robot.create_subscription("/x", full, None, got.extend)
    client = await ros1.client()
    client.send({"op": "advertise", "topic": "/x", "type": type})
    client.send({"op": "publish", "topic": "/x", "msg": msg})
    raw = SPELLING.codec(full).raw(REGISTRY.codec(full).encode(kept))
    client.send_binary(cbor2.dumps({"op": "publish", "topic": "/x", "msg": {"secs": 1, "nsecs": 2, "bytes": raw}}))
    await until(lambda: len(got) == 2)
    assert got[0].payload == got[1].payload == REGISTRY.codec(full).encode(kept)


async def test_reading(ros1: Place) -> None:
    """Messages come with seq, secs and nsecs, and cbor-raw has the bytes of ROS 1."""
    await publisher(ros1, "/head", "std_msgs/msg/Header", {"stamp": {"sec": 100, "nanosec": 5}, "frame_id": "l"})
    client = await ros1.client()
    client.send({"op": "subscribe", "topic": "/head"})
    got = await client.json()
    assert got["msg"] == {"seq": 0, "stamp": {"secs": 100, "nsecs": 5}, "frame_id": "l"}
    other = await ros1.client()
    other.send({"op": "subscribe", "topic": "/head", "compression": "cbor-raw"})
    raw = (await other.receive()).cbor["msg"]["bytes"]
    assert raw == bytes(4) + b"\x64\0\0\0\x05\0\0\0\x01\0\0\0l"


async def test_services(ros1: Place) -> None:
    """A service of a client is called and answered in the spelling of ROS 1."""
    provider, caller = await ros1.client(), await ros1.client()
    provider.send({"op": "advertise_service", "service": "/set", "type": "sensor_msgs/SetCameraInfo"})
    await provider.done()
    info = {"D": [1.5], "header": {"seq": 3}}
    caller.send({"op": "call_service", "id": "1", "service": "/set", "args": {"camera_info": info}})
    request = await provider.json()
    assert request["args"]["camera_info"]["D"] == [1.5]
    assert request["args"]["camera_info"]["header"]["stamp"] == {"secs": 0, "nsecs": 0}
    provider.send(
        {"op": "service_response", "id": request["id"], "service": "/set", "values": {"success": True}, "result": True}
    )
    assert (await caller.json())["values"]["success"] is True


async def test_rosapi(ros1: Place) -> None:
    """Types have names of two parts, and definitions and version are those of ROS 1."""
    await publisher(ros1, "/pose", "geometry_msgs/msg/PoseStamped", {})
    client = await ros1.client()

    async def ask(name: str, **args: Any) -> Any:
        client.send({"op": "call_service", "id": "q", "service": f"/rosapi/{name}", "args": args})
        return (await client.json())["values"]

    assert (await ask("topic_type", topic="/pose"))["type"] == "geometry_msgs/PoseStamped"
    for type in ("geometry_msgs/PoseStamped", "geometry_msgs/msg/PoseStamped"):
        assert (await ask("topics_for_type", type=type))["topics"] == ["/pose"]
    assert "geometry_msgs/PoseStamped" in (await ask("topics"))["types"]
    assert (await ask("service_type", service="/rosapi/topics"))["type"] == "rosapi/Topics"
    details = (await ask("message_details", type="std_msgs/Header"))["typedefs"]
    assert details[0]["fieldtypes"] == ["uint32", "time", "string"]
    assert await ask("get_ros_version") == {"version": 1, "distro": "noetic"}
    raw = await ask("topics_and_raw_types")
    assert raw["typedefs_full_text"][raw["topics"].index("/pose")].startswith("std_msgs/Header header\n")


async def test_no_log_of_ros2(ros1: Place) -> None:
    """The server's own log is not published there: it would be of another type than theirs."""
    client = await ros1.client()
    await client.done()
    assert "/rosout" not in ros1.robot.topics()


async def test_number_of_a_header_on_ros2(place: Place) -> None:
    """On ROS 2 the number in the header of an old client is passed over."""
    got: list[Any] = []
    await place.robot.create_subscription("/pose", "geometry_msgs/msg/PoseStamped", None, got.extend)
    client = await place.client()
    client.send({"op": "advertise", "topic": "/pose", "type": "geometry_msgs/PoseStamped"})
    client.send({"op": "publish", "topic": "/pose", "msg": {"header": {"seq": 7, "stamp": {"secs": 1, "nsecs": 2}}}})
    await until(lambda: bool(got))
    assert json.loads(REGISTRY.codec(got[0].type).json(got[0].payload))["header"]["stamp"] == {"sec": 1, "nanosec": 2}
    assert not place.complaints
