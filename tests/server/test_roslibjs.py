"""roslibjs 1 and 2, as web pages run them, against our server."""

from __future__ import annotations

import asyncio
import base64
import json
import shutil
from pathlib import Path

import pytest

from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.graph.hub import Hub
from ropeway.graph.memory import MemoryGraph
from ropeway.qos import QoS
from ropeway.server import RosbridgeServer
from ropeway.types import TypeRegistry
from tests.contract.conftest import Inbox, until
from tests.contract.test_topics import STRING, text

JS = Path(__file__).parents[1] / "js"
IMAGE = "sensor_msgs/msg/Image"

pytestmark = [
    pytest.mark.skipif(shutil.which("node") is None or shutil.which("npm") is None, reason="needs node and npm"),
    pytest.mark.timeout(180),
]


@pytest.fixture(scope="module")
def packages() -> None:
    """The clients, from the npm registry."""
    if not (JS / "node_modules" / "roslib2").exists():
        import subprocess

        subprocess.run(
            ["npm", "install", "--no-audit", "--no-fund", "--no-package-lock"],
            cwd=JS,
            check=True,
            capture_output=True,
            timeout=150,
        )


@pytest.mark.parametrize("compression", ["none", "png", "cbor", "cbor-raw"])
@pytest.mark.parametrize("version", ["roslib1", "roslib2"])
@pytest.mark.usefixtures("packages")
async def test_topics_both_ways(version: str, compression: str) -> None:
    """Topics go both ways with roslibjs, in every compression it has."""
    registry = TypeRegistry()
    graph, robot = MemoryGraph("roslibjs", node="/gateway"), MemoryGraph("roslibjs", node="/robot")
    await graph.open()
    await robot.open()
    server = RosbridgeServer(Hub(graph), registry, unregister_timeout_s=0.1)
    listener = await server.listen("ws://127.0.0.1:0")
    inbox = Inbox()
    await robot.create_subscription("/from_client", STRING, QoS(depth=100), inbox)
    publisher = await robot.create_publisher("/to_client", IMAGE)
    program = await asyncio.create_subprocess_exec(
        "node",
        "client.mjs",
        version,
        f"ws://127.0.0.1:{listener.port}",
        compression,
        cwd=JS,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    assert program.stdout is not None
    assert program.stdin is not None
    assert await asyncio.wait_for(program.stdout.readline(), 20) == b"ready\n"
    await until(lambda: publisher.subscribers)
    pixels = bytes(range(30))
    payload = registry.codec(IMAGE).encode({"width": 5, "height": 2, "encoding": "rgb8", "step": 15, "data": pixels})
    publisher.publish(Sample(payload, IMAGE, 0, bytes(16), SEQ_NONE))
    got = json.loads(await asyncio.wait_for(program.stdout.readline(), 20))
    if compression == "cbor-raw":
        assert got == {"raw": len(payload)}
    else:
        assert got == {"width": 5, "data": base64.b64encode(pixels).decode()}
    program.stdin.write("grüße\n".encode())
    await inbox.wait(1, 20)
    assert inbox.payloads == [text("grüße")]
    program.stdin.write(b"end\n")
    assert await asyncio.wait_for(program.wait(), 20) == 0
    await until(lambda: not server.sessions)
    await server.close()
    await robot.close()
    await graph.close()
