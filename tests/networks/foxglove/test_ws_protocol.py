"""The public client library of the protocol as a viewer; skipped where Node.js or the library is not there.

``npm ci --prefix tests/js`` installs it.
"""

from __future__ import annotations

import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.networks.foxglove.settings import FoxgloveSettings
from ropeway.qos import LATCHED, QoS
from tests.graph.parameter_node import ParameterNode
from tests.networks.foxglove.viewer import Sight
from tests.networks.rosbridge.server.peers import Peers, peers
from tests.support.inbox import Inbox
from tests.support.messages import STRING, text
from tests.support.services import ADD, add
from tests.support.until import until

PROGRAM = Path(__file__).parents[2] / "js" / "foxglove.mjs"
NODE = shutil.which("node")
if NODE is None:
    pytest.skip("needs Node.js, which .ci/run installs on Debian", allow_module_level=True)
if not (PROGRAM.parent / "node_modules" / "@foxglove").is_dir():
    pytest.skip("needs @foxglove/ws-protocol: npm ci --prefix tests/js", allow_module_level=True)

IMAGE, SCAN, TRANSFORMS = "sensor_msgs/msg/Image", "sensor_msgs/msg/LaserScan", "tf2_msgs/msg/TFMessage"
HEADER = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "cam"}
MESSAGES: dict[str, dict[str, Any]] = {
    STRING: {"data": "grüße"},
    IMAGE: {"header": HEADER, "height": 2, "width": 2, "step": 2, "encoding": "mono8", "data": bytes(range(4))},
    SCAN: {"header": HEADER, "ranges": [0.5, 1.25]},
    TRANSFORMS: {"transforms": [{"header": HEADER, "child_frame_id": "lens"}]},
}


@asynccontextmanager
async def viewer(sight: Sight, **plan: Any) -> AsyncIterator[Peers]:
    """Run the program with a plan."""
    assert NODE is not None
    async with peers(NODE, str(PROGRAM), str(sight.port), plan=plan) as program:
        await program.connected()
        yield program


def said(program: Peers, key: str) -> list[dict[str, Any]]:
    """Return what was said of a kind."""
    return [line for line in program.said if key in line]


async def test_messages(sight: Sight) -> None:
    """The library decodes the messages of every channel by the schema that it was told."""
    for number, (type, message) in enumerate(MESSAGES.items()):
        publisher = await sight.robot.create_publisher(f"/t{number}", type, LATCHED)
        publisher.publish(Sample(sight.registry.codec(type).encode(message), type, 0, bytes(16), SEQ_NONE))
    async with viewer(sight, subscribe=[f"/t{number}" for number in range(len(MESSAGES))]) as program:
        await program.wait(lambda: len(said(program, "message")) == len(MESSAGES))
        heard = {line["topic"]: line["message"] for line in said(program, "message")}
        assert heard["/t0"] == {"data": "grüße"}
        assert heard["/t1"]["data"] == [0, 1, 2, 3]
        assert heard["/t1"]["header"] == {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "cam"}
        assert heard["/t2"]["ranges"] == [0.5, 1.25]
        assert heard["/t3"]["transforms"][0]["child_frame_id"] == "lens"
        assert not said(program, "error")
        (info,) = said(program, "serverInfo")
        assert "services" in info["serverInfo"]["capabilities"]


async def test_publishing(sight: Sight) -> None:
    """What the library publishes arrives."""
    inbox = Inbox()
    await sight.robot.create_subscription("/cmd", STRING, QoS(), inbox)
    plan = {"publish": [{"topic": "/cmd", "schemaName": STRING, "message": {"data": "go"}}]}
    async with viewer(sight, **plan) as program:
        await until(lambda: sight.robot.topics()["/cmd"].publishers)
        program.publish()
        await inbox.wait(1)
    assert inbox.payloads == [text("go")]


async def test_everything_else(dark: Sight, tmp_path: Path) -> None:
    """Services, parameters, the graph and files reach the library as it expects them."""
    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "arm.stl").write_text("solid")
    await dark.start(FoxgloveSettings(asset_roots=(tmp_path,)))
    await dark.robot.create_service("/add", ADD, add)
    node = await ParameterNode({"x": 1.5}).serve(await dark.participant("/turtle"), "/turtle")
    plan: dict[str, Any] = {
        "call": [{"service": "/add", "request": {"a": 2, "b": 3}}],
        "parameters": ["/turtle.x"],
        "set": [{"name": "/turtle.x", "value": 2, "type": "float64"}],
        "graph": True,
        "asset": "package://robot/arm.stl",
    }
    async with viewer(dark, **plan) as program:
        for key in ("response", "graph", "asset"):
            await program.wait(lambda key=key: said(program, key))
        await program.wait(lambda: len(said(program, "parameters")) == 2)
        assert said(program, "response")[0]["response"] == {"sum": 5}
        assert said(program, "asset")[0]["text"] == "solid"
        got, put = said(program, "parameters")
        assert (got["id"], got["parameters"]) == ("get", [{"name": "/turtle.x", "value": 1.5, "type": "float64"}])
        assert (put["id"], put["parameters"][0]["value"]) == ("set", 2)
        graph = said(program, "graph")[0]["graph"]
        assert {"name": "/add", "providerIds": ["/robot"]} in graph["advertisedServices"]
        assert not said(program, "error")
    assert node.values == {"x": 2.0}
