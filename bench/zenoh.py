"""What it takes to join rmw_zenoh and DDS: delay, losses and processor time, beside DDS joined with DDS.

One process bridges one topic; another publishes on one side and reads on the other. Each pair of networks carries
images of 305 kB at 60 Hz, and messages of 1 kB at 2,000 per second. The pairs take turns, so that what else runs on the
machine disturbs all of them alike.
"""

from __future__ import annotations

import argparse
import asyncio
import statistics
import sys
import time
from collections.abc import Sequence
from contextlib import AsyncExitStack
from typing import Final, NamedTuple

import psutil
import uvloop
from tests.support.ports import free_port

import ropeway
from bench.report import table
from ropeway import aio
from ropeway.graph.base import SEQ_NONE, Publisher, Sample
from ropeway.networks.factory import open_graph
from ropeway.qos import QoS

SMALL, IMAGE = "std_msgs/msg/UInt8MultiArray", "sensor_msgs/msg/Image"
PAIRS: Final = (("dds", "dds"), ("zenoh", "dds"), ("dds", "zenoh"), ("zenoh", "zenoh"))
_PATIENCE_S: Final = 60.0
_QUIET_S: Final = 2.0  # after which nothing more arrives


class Work(NamedTuple):
    """Messages of ``size`` bytes, ``hz`` of them a second."""

    title: str
    type: str
    size: int
    hz: float


WORKS: Final = (Work("305 kB, 60 Hz", IMAGE, 305_000, 60.0), Work("1 kB, 2,000 Hz", SMALL, 1_000, 2_000.0))


class Figures(NamedTuple):
    """What was sent and arrived, the delays in milliseconds, and the processor time of the bridge in percent."""

    sent: int
    arrived: int
    delays_ms: list[float]
    cpu: float


def _ends(kind: str, domain: int) -> tuple[str, str]:
    """Return a network as the publisher or reader joins it, and as the bridge does."""
    if kind == "dds":
        return (f"dds:{domain}?interface=lo",) * 2
    one, other = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    return f"zenoh:{one}?domain={domain}&listen={other}", f"zenoh:{other}?domain={domain}&listen={one}"


async def measure(pair: tuple[str, str], work: Work, duration_s: float) -> Figures:
    """Publish at the rate of ``work`` for some seconds, and return what came of it."""
    (near_url, from_url), (far_url, to_url) = _ends(pair[0], 213), _ends(pair[1], 214)
    delays: list[float] = []

    def receive(batch: Sequence[Sample]) -> None:
        now = time.time_ns()
        delays.extend((now - sample.seq) / 1e6 for sample in batch)

    async with AsyncExitStack() as stack:
        near, far = await open_graph(near_url, name="near"), await open_graph(far_url, name="far")
        for graph in (near, far):
            stack.push_async_callback(graph.close)
        await far.create_subscription("/t", work.type, QoS(depth=1000), receive)
        publisher = await near.create_publisher("/t", work.type, QoS(depth=1000))
        child = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "bench.zenoh", "--bridge", from_url, to_url, work.type, stdin=asyncio.subprocess.PIPE
        )
        try:
            payload = b"\0\1\0\0" + bytes(work.size)
            async with aio.timeout(_PATIENCE_S):
                while not delays:
                    publisher.publish(Sample(payload, work.type, 0, bytes(16), SEQ_NONE))
                    await asyncio.sleep(0.1)
            await asyncio.sleep(1.0)
            delays.clear()
            process = psutil.Process(child.pid)
            before, began = sum(process.cpu_times()[:2]), time.monotonic()
            sent = await _publish(publisher, payload, work, duration_s)
            cpu = 100 * (sum(process.cpu_times()[:2]) - before) / (time.monotonic() - began)
            last = -1
            while last < len(delays) < sent:
                last = len(delays)
                await asyncio.sleep(_QUIET_S)
            return Figures(sent, len(delays), sorted(delays), cpu)
        finally:
            assert child.stdin is not None
            child.stdin.close()
            await child.wait()


async def _publish(publisher: Publisher, payload: bytes, work: Work, duration_s: float) -> int:
    count, begin = int(work.hz * duration_s), time.perf_counter()
    for number in range(count):
        if (wait_s := begin + number / work.hz - time.perf_counter()) > 0:
            await asyncio.sleep(wait_s)
        publisher.publish(Sample(payload, work.type, 0, bytes(16), time.time_ns()))
    return count


async def bridge(near: str, far: str, type: str) -> None:
    """Bridge the topic until standard input ends."""
    async with ropeway.open_bridge(near, far) as joined:
        await joined.topic("/t", type)
        await asyncio.to_thread(sys.stdin.read)


async def main(duration_s: float, rounds: int, *, as_json: bool) -> None:
    """Print the figures of each pair and work: the medians of all rounds, and every message that was lost."""
    rows = []
    for work in WORKS:
        found: dict[tuple[str, str], list[Figures]] = {pair: [] for pair in PAIRS}
        for _ in range(rounds):
            for pair in PAIRS:
                found[pair].append(await measure(pair, work, duration_s))
        for pair, figures in found.items():
            sent, arrived = sum(one.sent for one in figures), sum(one.arrived for one in figures)
            p50 = statistics.median(statistics.median(one.delays_ms or [0.0]) for one in figures)
            p99 = statistics.median(one.delays_ms[int(0.99 * (len(one.delays_ms) - 1))] for one in figures)
            cpu = statistics.median(one.cpu for one in figures)
            rows.append([work.title, " -> ".join(pair), f"{arrived}/{sent}", p50, p99, cpu])
    heads = ["messages", "networks", "delivered", "delay p50 ms", "p99 ms", "CPU % of the bridge"]
    table("one bridge between two networks", heads, rows, as_json=as_json)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--bridge", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    uvloop.run(
        bridge(*options.bridge) if options.bridge else main(options.seconds, options.rounds, as_json=options.json)
    )
