"""Bare DDS peers for measurements: a source of recorded or made messages, and a sink that measures.

``python -m bench.peers source --topic /image --kind rgb --hz 30 --seconds 10``
``python -m bench.peers sink --topic /image --seconds 12``

The sink prints one JSON object: per topic the number, rate (the paper's equation 1), delay (equation 2) and its
distribution, all by the header's stamp and one clock. ``ping`` and ``echo`` measure a round trip.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import struct
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import uvloop

from bench.images import IMAGE, frames, matrix
from ropeway import aio
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.networks.dds import DdsGraph
from ropeway.qos import QoS

CLOUD, STRING, TWIST = (
    "sensor_msgs/msg/PointCloud2",
    "std_msgs/msg/String",
    "geometry_msgs/msg/TwistStamped",
)
RECORDED = {
    "rgb": "/camera/color/image_raw",
    "depth": "/camera/depth/image_rect_raw",
    "lidar": "/lidar/points",
    "imu": "/imu/data",
    "odom": "/odom",
}
TYPES = {"rgb": IMAGE, "depth": IMAGE, "lidar": CLOUD, "imu": "sensor_msgs/msg/Imu", "odom": "nav_msgs/msg/Odometry"}
STAMP = struct.Struct("<iI")


def data_directory() -> Path | None:
    """Where the recordings are, if they are here."""
    for path in (os.environ.get("ROPEWAY_DATA", ""), Path(__file__).parents[2] / "shared" / "data"):
        if path and (Path(path) / "dev.mcap").exists():
            return Path(path)
    return None


def string(text: bytes) -> bytes:
    """A std_msgs/msg/String as CDR."""
    return b"\0\1\0\0" + struct.pack("<I", len(text) + 1) + text + b"\0"


def stamped(size: int) -> bytes:
    """A CDR message of about ``size`` bytes that begins with a Header (CompressedImage)."""
    head = b"\0\1\0\0" + bytes(8) + struct.pack("<I", 2) + b"a\0" + bytes(2) + struct.pack("<I", 2) + b"x\0" + bytes(2)
    body = max(size - len(head) - 4, 0)
    return head + struct.pack("<I", body) + np.random.default_rng(1).integers(0, 256, body, np.uint8).tobytes()


def messages(kind: str) -> tuple[str, list[bytes]]:
    """The type and the messages of a kind: recorded ones, made ones, or ``<number>`` bytes that nothing compresses."""
    if kind == "twist":
        return TWIST, [b"\0\1\0\0" + bytes(8) + struct.pack("<I", 1) + bytes(4) + bytes(48)]
    if kind.isdigit():
        return "sensor_msgs/msg/CompressedImage", [stamped(int(kind))]
    if kind == "matrix":
        return IMAGE, [matrix()]
    directory = data_directory()
    if directory is None:
        if kind in ("rgb", "depth"):
            return IMAGE, frames(kind)
        return "sensor_msgs/msg/CompressedImage", [stamped({"lidar": 248979}.get(kind, 400))]
    from mcap.reader import make_reader

    out: list[bytes] = []
    with (directory / "dev.mcap").open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages(topics=[RECORDED[kind]]):
            out.append(message.data)
    return TYPES[kind], out


def restamp(payload: bytes, now_ns: int) -> bytes:
    """The message with its header's stamp set to ``now_ns``."""
    return b"".join((payload[:4], STAMP.pack(now_ns // 1_000_000_000, now_ns % 1_000_000_000), payload[12:]))


def profile(args: argparse.Namespace) -> QoS:
    """The QoS that the arguments ask for."""
    return QoS(
        reliability="best_effort" if args.best_effort else "reliable",
        history="keep_all" if args.keep_all else "keep_last",
        depth=args.depth,
    )


async def source(args: argparse.Namespace) -> None:
    """Publish all topics in turn; prints what was sent."""
    graph = DdsGraph(args.domain, name="source", interface=args.interface)
    await graph.open()
    parts = []
    for topic, kind in zip(args.topic.split(","), args.kind.split(","), strict=True):
        type, payloads = messages(kind)
        publisher = await graph.create_publisher(topic, args.type or type, profile(args))
        parts.append((publisher, type, _cycle(payloads)))
    loop = asyncio.get_running_loop()
    deadline = loop.time() + 10
    while not all(publisher.subscribers for publisher, _, _ in parts) and loop.time() < deadline:
        await asyncio.sleep(0.02)
    await asyncio.sleep(args.settle)
    print("started", flush=True)
    began = loop.time()
    n = 0
    while loop.time() - began < args.seconds and (not args.count or n < args.count):
        for publisher, type, stream in parts:
            now = time.time_ns()
            publisher.publish(Sample(restamp(next(stream), now), type, now, bytes(16), SEQ_NONE))
        n += 1
        if args.hz:
            ahead = began + n / args.hz - loop.time()
            if ahead > 0.001 or args.hz < 1000:  # faster than timers are: in bursts of a millisecond
                await asyncio.sleep(max(0.0, ahead))
            elif n % 64 == 0:
                await asyncio.sleep(0)
        elif n % args.burst == 0:
            await asyncio.sleep(0)
    print(json.dumps({"sent": n * len(parts), "seconds": loop.time() - began}), flush=True)
    await asyncio.sleep(0.5)
    await graph.close()


def _cycle(payloads: list[bytes]) -> Iterator[bytes]:
    while True:
        yield from payloads


async def sink(args: argparse.Namespace) -> None:
    """Measure."""
    graph = DdsGraph(args.domain, name="sink", interface=args.interface)
    await graph.open()
    got: dict[str, list[tuple[float, float, int]]] = {}
    expected = {m[12:] for k in args.kind.split(",") for m in messages(k)[1]} if args.check else set()
    wrong = 0
    types = {t: messages(k)[0] for t, k in zip(args.topic.split(","), args.kind.split(","), strict=False)}
    if args.type:
        types = dict.fromkeys(args.topic.split(","), args.type)
    for topic in args.topic.split(","):
        rows = got[topic] = []

        def receive(batch: Sequence[Sample], rows: list[tuple[float, float, int]] = rows) -> None:
            nonlocal wrong
            now = time.time_ns()
            for sample in batch:
                sec, nsec = STAMP.unpack_from(sample.payload, 4)
                rows.append((now / 1e9, (now - sec * 1_000_000_000 - nsec) / 1e9, len(sample.payload)))
                if expected and sample.payload[12:] not in expected:
                    wrong += 1

        await graph.create_subscription(topic, types.get(topic, args.type or IMAGE), profile(args), receive)
    print("ready", flush=True)
    await asyncio.sleep(args.seconds)
    print(
        json.dumps(
            {topic: figures(rows, args.limit_ms) for topic, rows in got.items()}
            | ({"wrong": wrong} if args.check else {})
        ),
        flush=True,
    )
    await graph.close()


def figures(rows: list[tuple[float, float, int]], limit_ms: float = 0.0) -> dict[str, float]:
    """Rate and delay of what arrived, and the share that took ``limit_ms`` at most."""
    if len(rows) < 2:
        return {"n": len(rows)}
    times = np.array([r[0] for r in rows])
    delays = np.array([r[1] for r in rows])
    span = times[-1] - times[0]
    return {
        "n": len(rows),
        "rate_hz": float((len(rows) - 1) / span),
        "mbps": float(sum(r[2] for r in rows[1:]) / span / 1e6),
        "delay_min_ms": float(delays.min() * 1e3),
        "delay_mean_ms": float(delays.mean() * 1e3),
        "within": float((delays * 1e3 <= limit_ms).mean()) if limit_ms else 1.0,
        "delay_p50_ms": float(np.percentile(delays, 50) * 1e3),
        "delay_p99_ms": float(np.percentile(delays, 99) * 1e3),
        "delay_max_ms": float(delays.max() * 1e3),
        "gap_max_ms": float(np.diff(times).max() * 1e3),
    }


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("role", choices=["source", "sink"])
    parser.add_argument("--domain", type=int, default=0)
    parser.add_argument("--interface", default="lo")
    parser.add_argument("--topic", default="/t")
    parser.add_argument("--type", default="")
    parser.add_argument("--kind", default="rgb")
    parser.add_argument("--hz", type=float, default=0)
    parser.add_argument("--seconds", type=float, default=5)
    parser.add_argument("--count", type=int, default=0)
    parser.add_argument("--settle", type=float, default=0.3)
    parser.add_argument("--limit-ms", type=float, default=0)
    parser.add_argument("--burst", type=int, default=16)
    parser.add_argument("--depth", type=int, default=10)
    parser.add_argument("--best-effort", action="store_true")
    parser.add_argument("--keep-all", action="store_true")
    parser.add_argument("--check", action="store_true")
    args = parser.parse_args()
    with aio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run({"source": source, "sink": sink}[args.role](args))


if __name__ == "__main__":
    main()
