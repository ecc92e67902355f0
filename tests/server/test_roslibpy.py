"""roslibpy, as its users run it, against our server."""

from __future__ import annotations

import asyncio
import json
import math
import sys
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

pytest.importorskip("roslibpy")

CLIENT = Path(__file__).with_name("roslibpy_client.py")
IMU = "sensor_msgs/msg/Imu"


@pytest.mark.parametrize("clients", [1, 8])
async def test_topics_both_ways(clients: int) -> None:
    """Topics go both ways with roslibpy; NaN in a covariance, which is no JSON, comes as null."""
    registry = TypeRegistry()
    graph, robot = MemoryGraph("roslibpy", node="/gateway"), MemoryGraph("roslibpy", node="/robot")
    await graph.open()
    await robot.open()
    server = RosbridgeServer(Hub(graph), registry, unregister_timeout_s=0.1)
    listener = await server.listen("ws://127.0.0.1:0")
    inbox = Inbox()
    await robot.create_subscription("/from_client", STRING, QoS(depth=100), inbox)
    publisher = await robot.create_publisher("/to_client", IMU)
    programs = [
        await asyncio.create_subprocess_exec(
            sys.executable,
            str(CLIENT),
            "127.0.0.1",
            str(listener.port),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
        )
        for _ in range(clients)
    ]
    codec = registry.codec(IMU)
    covariance = [math.nan] + [0.0] * 8
    message = codec.encode({"header": {"frame_id": "imu"}, "orientation_covariance": covariance})
    for program in programs:
        assert program.stdout is not None
        assert (await asyncio.wait_for(program.stdout.readline(), 20)) == b"ready\n"
    await until(lambda: sum(len(s.outputs) for s in server.sessions) == clients)
    await until(lambda: publisher.subscribers == 1 or (publisher.subscribers or 0) >= clients)
    publisher.publish(Sample(message, IMU, 0, bytes(16), SEQ_NONE))
    for number, program in enumerate(programs):
        assert program.stdout is not None
        assert program.stdin is not None
        got = json.loads(await asyncio.wait_for(program.stdout.readline(), 20))
        assert got["header"]["frame_id"] == "imu"
        assert got["orientation_covariance"][0] is None
        program.stdin.write(f"word{number}\n".encode())
    await inbox.wait(clients, 20)
    assert sorted(inbox.payloads) == sorted(text(f"word{n}") for n in range(clients))
    for program in programs:
        assert program.stdin is not None
        program.stdin.write(b"end\n")
    assert [await asyncio.wait_for(p.wait(), 20) for p in programs] == [0] * clients
    await until(lambda: not server.sessions)
    await server.close()
    await robot.close()
    await graph.close()
