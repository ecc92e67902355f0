"""Viewers of a ROS 1 network: schemas, messages and services as ROS 1 has them, and the parameters of the master."""

from __future__ import annotations

import json
import struct
from typing import Any

import pytest

from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.hub.hub import Hub
from ropeway.networks.foxglove.server import FoxgloveServer
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import LATCHED, QoS
from ropeway.types.ros1_spelling import Ros1Spelling
from ropeway.types.ros1_types import Ros1Types
from tests.networks.foxglove.viewer import Sight
from tests.support.inbox import Inbox
from tests.support.messages import STRING, text
from tests.support.rosbridge import REGISTRY
from tests.support.services import ADD, add

POSE = "geometry_msgs/msg/PointStamped"


class MasterNetwork(MemoryGraph):
    """A network in memory that says that it is one of ROS 1, with the parameters of a master."""

    ros1_spelling = Ros1Spelling(Ros1Types(REGISTRY))

    def __init__(self, network: str, *, node: str) -> None:
        super().__init__(network, node=node)
        self.values: dict[str, Any] = {"/speed": 0.5, "/robot/name": "r", "/tree": {"a": 1}}

    async def get_param(self, name: str) -> Any:
        return self.values[name]

    async def set_param(self, name: str, value: Any) -> None:
        if value == []:
            raise ValueError("an empty list cannot be kept")
        self.values[name] = value

    async def delete_param(self, name: str) -> None:
        del self.values[name]

    async def list_params(self) -> list[str]:
        return list(self.values)


@pytest.fixture
async def master(dark: Sight) -> MasterNetwork:
    """A server on such a network."""
    graph = MasterNetwork(dark.network, node="/gateway")
    await graph.open()
    dark.stack.push_async_callback(graph.close)
    dark.robot = await dark.participant("/robot")
    dark.hub = Hub(graph)
    dark.server = FoxgloveServer(dark.hub, REGISTRY)
    dark.stack.push_async_callback(dark.server.close)
    dark.port = (await dark.server.listen("foxglove://127.0.0.1:0")).port
    return graph


async def test_messages(dark: Sight, master: MasterNetwork) -> None:
    """A channel has ROS 1's schema, and messages come in the bytes that a ROS 1 node sends, made once for all."""
    publisher = await dark.robot.create_publisher("/point", POSE, LATCHED)
    value = {"header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "m"}, "point": {"x": 1.0, "y": 2.0, "z": 3.0}}
    sample = Sample(REGISTRY.codec(POSE).encode(value), POSE, 0, bytes(16), SEQ_NONE)
    publisher.publish(sample)
    expected = struct.pack("<IIII", 0, 1, 2, 1) + b"m" + struct.pack("<3d", 1.0, 2.0, 3.0)
    for _ in range(2):
        viewer = await dark.viewer()
        channel = await viewer.subscribe("/point")
        assert (channel["encoding"], channel["schemaEncoding"]) == ("ros1", "ros1msg")
        assert channel["schemaName"] == "geometry_msgs/PointStamped"
        assert "uint32 seq" in channel["schema"]
        assert (await viewer.message()).payload == expected


@pytest.mark.parametrize(("encoding", "body"), [("ros1", b"\2\0\0\0hi"), ("json", b'{"data":"hi"}')])
async def test_publishing(dark: Sight, master: MasterNetwork, encoding: str, body: bytes) -> None:
    """What a viewer publishes as ROS 1 has it arrives."""
    inbox = Inbox()
    await dark.robot.create_subscription("/cmd", STRING, QoS(), inbox)
    viewer = await dark.viewer()
    channel = {"id": 1, "topic": "/cmd", "encoding": encoding, "schemaName": "std_msgs/String"}
    viewer.send({"op": "advertise", "channels": [channel]})
    viewer.send_binary(struct.pack("<BI", 1, 1) + body)
    await inbox.wait(1)
    assert inbox.payloads == [text("hi")]


async def test_services(dark: Sight, master: MasterNetwork) -> None:
    """A service is called with the bytes of ROS 1."""
    await dark.robot.create_service("/add", ADD, add)
    viewer = await dark.viewer()
    service = await viewer.service("/add")
    assert service["type"] == "example_interfaces/AddTwoInts"
    assert service["request"]["schemaEncoding"] == "ros1msg"
    call = struct.pack("<BIII", 2, service["id"], 1, 4) + b"ros1" + struct.pack("<qq", 2, 3)
    viewer.send_binary(call)
    await viewer.until(lambda: viewer.binary)
    assert viewer.binary[0][17:] == struct.pack("<q", 5)


async def test_parameters(dark: Sight, master: MasterNetwork) -> None:
    """The parameters of the master are read, set and deleted; that nobody is told of changes is said at first."""
    viewer = await dark.viewer()
    info = await viewer.op("serverInfo")
    assert "parameters" in info["capabilities"]
    assert "parametersSubscribe" not in info["capabilities"]
    viewer.send({"op": "getParameters", "parameterNames": [], "id": "all"})
    told = await viewer.op("parameterValues")
    assert {each["name"]: each["value"] for each in told["parameters"]} == json.loads(json.dumps(master.values))
    given = [
        {"name": "/speed", "value": 2, "type": "float64"},
        {"name": "/robot/name"},
        {"name": "/empty", "value": []},
    ]
    viewer.send({"op": "setParameters", "parameters": given, "id": "set"})
    assert "an empty list cannot be kept" in await viewer.complaint()
    told = await viewer.op("parameterValues")
    assert told["parameters"][0] == {"name": "/speed", "value": 2.0, "type": "float64"}
    assert master.values == {"/speed": 2.0, "/tree": {"a": 1}}
