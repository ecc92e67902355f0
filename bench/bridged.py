"""Measures a bridge between two networks: one process bridges a topic, another publishes and reads on its two sides."""

from __future__ import annotations

import argparse
import asyncio
import statistics
import struct
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from typing import Final, NamedTuple

import psutil
import uvloop

import ropeway
from bench.report import table
from ropeway import aio
from ropeway.graph.base import SEQ_NONE, Publisher, Sample
from ropeway.networks.factory import open_graph
from ropeway.qos import QoS

__all__ = ["BYTES", "Ends", "Figures", "Work", "compare", "measure", "options"]

_PATIENCE_S: Final = 60.0
_QUIET_S: Final = 2.0  # after which nothing more arrives

Ends = tuple[str, str]
"""A network as the publisher or reader joins it, and as the bridge does."""


BYTES: Final = "std_msgs/msg/UInt8MultiArray"


class Work(NamedTuple):
    """Messages of ``size`` bytes, ``hz`` of them a second."""

    title: str
    type: str
    size: int
    hz: float
    reliability: str = "reliable"

    @property
    def qos(self) -> QoS:
        """The profile of both ends."""
        return QoS(reliability=self.reliability, depth=1000)

    @property
    def payload(self) -> bytes:
        """A message in CDR: of an array of bytes a real one, of others as many bytes."""
        if self.type == BYTES:
            return b"\0\1\0\0" + bytes(8) + struct.pack("<I", self.size) + bytes(self.size)
        return b"\0\1\0\0" + bytes(self.size)


class Figures(NamedTuple):
    """What was sent and arrived, the delays in milliseconds, and the processor time of the bridge in percent."""

    sent: int
    arrived: int
    delays_ms: list[float]
    cpu: float


async def measure(near_ends: Ends, far_ends: Ends, work: Work, duration_s: float) -> Figures:
    """Publish at the rate of ``work`` for some seconds, and return what came of it."""
    (near_url, from_url), (far_url, to_url) = near_ends, far_ends
    delays: list[float] = []

    def receive(batch: Sequence[Sample]) -> None:
        now = time.time_ns()
        delays.extend((now - sample.seq) / 1e6 for sample in batch)

    async with AsyncExitStack() as stack:
        near, far = await open_graph(near_url, name="near"), await open_graph(far_url, name="far")
        for graph in (near, far):
            stack.push_async_callback(graph.close)
        await far.create_subscription("/t", work.type, work.qos, receive)
        publisher = await near.create_publisher("/t", work.type, work.qos)
        child = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "bench.bridged", from_url, to_url, work.type, stdin=asyncio.subprocess.PIPE
        )
        try:
            payload = work.payload
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


async def compare(
    works: Sequence[Work],
    pairs: Sequence[tuple[str, str]],
    ends: Callable[[str, int], Ends],
    asked: argparse.Namespace,
) -> None:
    """Print the figures of each pair and work: the medians of all rounds, and every message that was lost."""
    rows = []
    for work in works:
        found: dict[tuple[str, str], list[Figures]] = {pair: [] for pair in pairs}
        for _ in range(asked.rounds):
            for pair in pairs:
                found[pair].append(await measure(ends(pair[0], 213), ends(pair[1], 214), work, asked.seconds))
        for pair, figures in found.items():
            sent, arrived = sum(one.sent for one in figures), sum(one.arrived for one in figures)
            p50 = statistics.median(statistics.median(one.delays_ms or [0.0]) for one in figures)
            p99 = statistics.median(one.delays_ms[int(0.99 * (len(one.delays_ms) - 1))] for one in figures)
            cpu = statistics.median(one.cpu for one in figures)
            rows.append([work.title, " -> ".join(pair), f"{arrived}/{sent}", p50, p99, cpu])
    heads = ["messages", "networks", "delivered", "delay p50 ms", "p99 ms", "CPU % of the bridge"]
    table("one bridge between two networks", heads, rows, as_json=asked.json)


def options(text: str | None) -> argparse.Namespace:
    """Return what the command line asks for."""
    parser = argparse.ArgumentParser(description=text)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    return parser.parse_args()


if __name__ == "__main__":
    uvloop.run(bridge(*sys.argv[1:]))
