"""What a message costs two gateways: processor time and switches, of both together in one process.

One message at a time is published and awaited, or a burst of them, over ``memory`` graphs (the way from one to the
other: bridge, outbox, socket, and back) and over DDS (the same, and taking from DDS, handing over to the event loop and
writing to DDS). The least of all rounds is the figure: what else runs on the machine only adds to them. With
``--pause-ms`` the processor rests before each message, as it does between those of a slow topic, and finds little of
its way in the caches; the rest does not count.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import resource
import time
from contextlib import AsyncExitStack
from typing import Any, Final, NamedTuple

import uvloop

from bench.report import table
from ropeway import aio
from ropeway.gateway.config.config import parse
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import Sample
from ropeway.networks.factory import open_graph

SMALL, IMAGE = "std_msgs/msg/UInt8MultiArray", "sensor_msgs/msg/Image"
GRAPHS: Final = {"memory": ("memory:cost_a", "memory:cost_b"), "dds": ("dds:211?interface=lo", "dds:212?interface=lo")}
_PATIENCE_S: Final = 60.0
_PER_ROUND: Final = 100


class Work(NamedTuple):
    """Messages of ``size`` bytes, ``burst`` of them at a time."""

    title: str
    size: int
    burst: int


WORKS: Final = (
    Work("1 kB, one at a time", 1000, 1),
    Work("1 kB, in bursts of 50", 1000, 50),
    Work("305 kB, one at a time", 305_000, 1),
)


class Cost(NamedTuple):
    """What one message costs: microseconds of the processor, those of the event loop among them, and switches."""

    total_us: float
    loop_us: float
    switches: float


async def measure(graph: str, work: Work, rounds: int, port: int, pause_s: float = 0.0) -> Cost:
    """Return what one message costs; ``pause_s`` is waited before each, or before each burst."""
    near_url, far_url = GRAPHS[graph]
    address = f"ws://127.0.0.1:{port}"
    type = IMAGE if work.size > 1 << 16 else SMALL
    listens: dict[str, Any] = {"gateway": {"graphs": [far_url], "listen": [address]}}
    route = {"name": "/t", "type": type, "compression": "cbor-raw"}
    dials = {"gateway": {"graphs": [near_url], "listen": []}, "remotes": [{"address": address, "publish": [route]}]}
    async with AsyncExitStack() as stack:
        for configuration in (listens, dials):
            await stack.enter_async_context(Gateway(parse(configuration)))
        graphs = []
        for url in (near_url, far_url):
            graphs.append(await open_graph(url))
            stack.push_async_callback(graphs[-1].close)
        near, far = graphs
        arrived, wanted, complete = 0, 1, asyncio.Event()

        def receive(batch: Any) -> None:
            nonlocal arrived
            arrived += len(batch)
            if arrived >= wanted:
                complete.set()

        await far.create_subscription("/t", type, None, receive)
        publisher = await near.create_publisher("/t", type)
        sample = Sample(b"\0\1\0\0" + bytes(work.size), type, 0, bytes(16), 0)
        async with aio.timeout(_PATIENCE_S):
            while not arrived:  # until everybody has found everybody
                publisher.publish(sample)
                await asyncio.sleep(0.05)
        gc.collect()
        found = []
        for _ in range(rounds):
            cost = Cost(0, 0, 0)
            for _ in range(_PER_ROUND // work.burst):
                if pause_s:
                    await asyncio.sleep(pause_s)
                wanted = arrived + work.burst
                complete.clear()
                before = _used()
                for _ in range(work.burst):
                    publisher.publish(sample)
                async with aio.timeout(_PATIENCE_S):
                    await complete.wait()
                cost = Cost(*(sum(parts) for parts in zip(cost, _used(), (-part for part in before), strict=True)))
            found.append(Cost(*(part / _PER_ROUND for part in cost)))
        return min(found)


def _used() -> Cost:
    """Return what this process has used so far."""
    switches = resource.getrusage(resource.RUSAGE_SELF).ru_nvcsw
    return Cost(1e6 * time.process_time(), 1e6 * time.thread_time(), switches)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--graphs", default="memory,dds")
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--port", type=int, default=19496)
    parser.add_argument("--pause-ms", type=float, default=0.0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows: list[list[Any]] = []
    for work in WORKS:
        for graph in args.graphs.split(","):
            cost = uvloop.run(measure(graph, work, args.rounds, args.port, args.pause_ms / 1e3))
            rows.append([work.title, graph, cost.total_us, cost.loop_us, cost.switches])
    heads = ["messages", "graphs", "processor us", "of the event loop", "switches"]
    table("one message through two gateways", heads, rows, as_json=args.json)


if __name__ == "__main__":
    main()
