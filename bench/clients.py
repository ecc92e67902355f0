"""Clients of the server: what idle ones cost, how fast an image becomes JSON, how many images a raw client gets.

The original spends about 150 ms on the JSON of one 640x480 rgb8 image.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import uvloop

from bench.loopback import measure as measure_dds
from bench.netns import Process
from bench.paper import config
from bench.peers import IMAGE
from bench.readers import DOMAIN, PORT, reader
from bench.report import table
from ropeway.errors import ConnectFailed
from ropeway.listener.connection import Connection, Limits
from ropeway.listener.websocket import connect
from ropeway.networks.rosbridge.protocol.codec import encode_publish
from ropeway.types import TypeRegistry

ORIGINAL_MS = 150.0


async def idle(count: int, seconds: float) -> tuple[float, float]:
    """Processor share of the gateway in per cent of a core, and MB per client."""
    with tempfile.TemporaryDirectory() as directory:
        path = config(Path(directory), "server", [], f"ws://127.0.0.1:{PORT}", f"dds:{DOMAIN}?interface=lo")
        gateway = Process(None, "-m", "ropeway", "run", path, "--quiet")
        first = await _idle_client()
        await asyncio.sleep(2)
        before = gateway.memory_bytes()
        clients = [first] + [await _idle_client() for _ in range(count)]
        await asyncio.sleep(3)
        cpu, began = gateway.cpu_s(), time.monotonic()
        await asyncio.sleep(seconds)
        share = 100 * (gateway.cpu_s() - cpu) / (time.monotonic() - began)
        grown = gateway.memory_bytes() - before
        for client in clients:
            client.close()
        gateway.stop()
    return share, grown / count / 1e6


async def _idle_client() -> Connection:
    for _ in range(200):
        try:
            client = await connect(f"ws://127.0.0.1:{PORT}", limits=Limits(ping_interval_s=None))
            break
        except ConnectFailed:
            await asyncio.sleep(0.1)
    else:
        raise SystemExit("the gateway does not answer")
    client.send_text(json.dumps({"op": "subscribe", "topic": "/quiet", "type": "std_msgs/msg/String"}))
    return client


def image() -> bytes:
    """A 640x480 rgb8 image as CDR."""
    registry = TypeRegistry()
    pixels = np.random.default_rng(1).integers(0, 256, 640 * 480 * 3, dtype=np.uint8)
    return registry.codec(IMAGE).encode(
        {
            "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "camera"},
            "height": 480,
            "width": 640,
            "encoding": "rgb8",
            "is_bigendian": 0,
            "step": 1920,
            "data": pixels,
        }
    )


def encoding_ms(repeat: int) -> float:
    """Milliseconds for the whole frame of one image to a JSON client, the median."""
    codec, payload = TypeRegistry().codec(IMAGE), image()
    times = []
    for _ in range(repeat):
        began = time.perf_counter()
        encode_publish("/image", payload, codec, "none", stamp_ns=0)
        times.append(time.perf_counter() - began)
    return 1e3 * float(np.median(times))


async def raw_rate(seconds: float) -> float:
    """Images per second that a cbor-raw client gets of a source that sends flat out."""
    with tempfile.TemporaryDirectory() as directory:
        path = config(Path(directory), "server", [], f"ws://127.0.0.1:{PORT}", f"dds:{DOMAIN}?interface=lo")
        gateway = Process(None, "-m", "ropeway", "run", path, "--quiet")
        got = [0]
        client = await reader("cbor-raw", got)
        args = ("source", "--domain", str(DOMAIN), "--topic", "/rgb", "--kind", "rgb", "--hz", "0")
        source = Process(None, "-m", "bench.peers", *args, "--burst", "1", "--seconds", str(seconds + 3))
        source.line()
        await asyncio.sleep(1)
        first, began = got[0], time.monotonic()
        await asyncio.sleep(seconds)
        rate = (got[0] - first) / (time.monotonic() - began)
        client.close()
        source.stop()
        gateway.stop()
    return rate


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--clients", type=int, default=100)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    share, grown = uvloop.run(idle(args.clients, args.seconds))
    heads = ["clients", "CPU, % of a core (< 2)", "MB each (<= 0.5)"]
    table("idle clients", heads, [[args.clients, share, grown]], as_json=args.json)
    took = encoding_ms(50)
    heads = ["ms", "times faster than the original's 150 ms (>= 50)"]
    table("one 640x480 rgb8 image as JSON", heads, [[took, ORIGINAL_MS / took]], as_json=args.json)
    bare: dict[str, Any] = measure_dds({"/rgb": "rgb"}, hz=0, seconds=args.seconds / 2, pair=False, burst=1)
    rate, alone = uvloop.run(raw_rate(args.seconds / 2)), bare["topics"]["/rgb"]["rate_hz"]
    heads = ["images/s", "bare DDS", "ratio (>= 0.5)"]
    table("recorded images to a cbor-raw client", heads, [[rate, alone, rate / alone]], as_json=args.json)


if __name__ == "__main__":
    main()
