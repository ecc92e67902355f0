"""Many WebSocket readers of one image topic: what does one more reader cost the gateway? And a stalled one?

The image is encoded once; every further reader costs one send. A reader that stops reading costs nothing that grows.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import uvloop

from bench.netns import Process
from bench.paper import config
from bench.report import table
from ropeway.errors import ConnectFailed
from ropeway.listener.connection import Connection, Limits
from ropeway.listener.websocket import connect

PORT, DOMAIN, HZ = 19292, 67, 30


async def reader(compression: str, got: list[int]) -> Connection:
    """One client that counts what it gets."""
    for _ in range(100):
        try:
            client = await connect(f"ws://127.0.0.1:{PORT}", limits=Limits(ping_interval_s=None))
            break
        except ConnectFailed:
            await asyncio.sleep(0.1)

    def count(_: object) -> None:
        got[0] += 1

    client.on_text = client.on_binary = count  # type: ignore[assignment]
    subscribe = {"op": "subscribe", "topic": "/rgb", "type": "sensor_msgs/msg/Image", "compression": compression}
    client.send_text(json.dumps(subscribe))
    return client


def start(directory: str, seconds: float) -> tuple[Process, Process]:
    """A gateway and a camera."""
    path = config(Path(directory), "server", [], f"ws://127.0.0.1:{PORT}", f"dds:{DOMAIN}?interface=lo")
    gateway = Process(None, "-m", "ropeway", "run", path, "--quiet")
    camera = Process(
        None,
        "-m",
        "bench.peers",
        "source",
        "--domain",
        str(DOMAIN),
        "--topic",
        "/rgb",
        "--kind",
        "rgb",
        "--hz",
        str(HZ),
        "--seconds",
        str(seconds),
    )
    return gateway, camera


async def cost(compression: str, readers: int, seconds: float) -> tuple[float, float]:
    """Processor milliseconds per message of the topic, and messages per second and reader."""
    with tempfile.TemporaryDirectory() as directory:
        gateway, camera = start(directory, seconds + 30)
        await asyncio.sleep(2)
        got = [0]
        clients = [await reader(compression, got) for _ in range(readers)]
        await asyncio.sleep(1)
        cpu, began, first = gateway.cpu_s(), time.monotonic(), got[0]
        await asyncio.sleep(seconds)
        span = time.monotonic() - began
        used = gateway.cpu_s() - cpu
        arrived = got[0] - first
        for client in clients:
            client.close()
        camera.stop()
        gateway.stop()
    return 1e3 * used / (HZ * span), arrived / readers / span


async def stalled(seconds: float) -> tuple[float, float, float]:
    """Memory before and after a reader stalls, and the rate of another reader meanwhile."""
    with tempfile.TemporaryDirectory() as directory:
        gateway, camera = start(directory, seconds + 30)
        await asyncio.sleep(2)
        got, none = [0], [0]
        good, bad = await reader("none", got), await reader("none", none)
        await asyncio.sleep(3)
        bad.pause_reading()
        await asyncio.sleep(3)
        before, first, began = gateway.memory_bytes(), got[0], time.monotonic()
        await asyncio.sleep(seconds)
        rate = (got[0] - first) / (time.monotonic() - began)
        after = gateway.memory_bytes()
        good.close()
        bad.abort("done")
        camera.stop()
        gateway.stop()
    return before / 1e6, after / 1e6, rate


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6)
    parser.add_argument("--stall", type=float, default=60)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows: list[list[Any]] = []
    for compression in ("none", "cbor", "cbor-raw"):
        alone = None
        for count in (1, 10, 50):
            used, rate = uvloop.run(cost(compression, count, args.seconds))
            alone = used if alone is None else alone
            rows.append([compression, count, rate, used, (used - alone) / (count - 1) if count > 1 else None])
    heads = ["compression", "readers", "messages/s each", "CPU ms per message", "ms per further reader"]
    table(f"readers of one image topic at {HZ} Hz", heads, rows, as_json=args.json)
    before, after, rate = uvloop.run(stalled(args.stall))
    row = [args.stall, before, after, after - before, rate]
    heads = ["seconds", "memory MB", "after", "grown (<= 10)", "other reader, messages/s"]
    table("a stalled reader", heads, [row], as_json=args.json)


if __name__ == "__main__":
    main()
