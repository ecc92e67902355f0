"""Cold start: from starting ``ropeway run`` to the first message that it forwards, and the memory it then has."""

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
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.networks.dds import DdsGraph
from ropeway.qos import QoS

STRING = "std_msgs/msg/String"
PAYLOAD = b"\0\1\0\0\6\0\0\0hello\0"


async def once(topics: int) -> tuple[float, float]:
    """Seconds to the first message, and megabytes a second later."""
    near, far = DdsGraph(65, name="source", interface="lo"), DdsGraph(66, name="sink", interface="lo")
    await near.open()
    await far.open()
    arrived = asyncio.Event()
    with tempfile.TemporaryDirectory() as directory:
        there = config(Path(directory), "there", [], "ws://127.0.0.1:19191", "dds:66?interface=lo")
        items = [{"name": f"/t{i}", "type": STRING} for i in range(topics)]
        remote = [{"address": "ws://127.0.0.1:19191", "publish": items}]
        here = config(Path(directory), "here", remote, None, "dds:65?interface=lo")
        server = Process(None, "-m", "ropeway", "run", there, "--quiet")
        for i in range(topics):
            await far.create_subscription(f"/t{i}", STRING, QoS(), lambda _: arrived.set())
        publishers = [await near.create_publisher(f"/t{i}", STRING) for i in range(topics)]
        await asyncio.sleep(2)
        began = time.monotonic()
        client = Process(None, "-m", "ropeway", "run", here, "--quiet")
        while not arrived.is_set():
            for publisher in publishers:
                publisher.publish(Sample(PAYLOAD, STRING, time.time_ns(), bytes(16), SEQ_NONE))
            await asyncio.sleep(0.01)
        seconds = time.monotonic() - began
        await asyncio.sleep(1)
        memory = client.memory_bytes() / 1e6
        client.stop()
        server.stop()
    await near.close()
    await far.close()
    return seconds, memory


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows: list[list[Any]] = []
    for topics in (1, 10):
        results = sorted(uvloop.run(once(topics)) for _ in range(args.runs))
        middle = results[len(results) // 2]
        rows.append([topics, middle[0], results[-1][0], middle[1]])
    table(
        "cold start", ["topics", "first message s (< 1.5)", "slowest s", "memory MB (<= 120)"], rows, as_json=args.json
    )
    if args.json:
        print(json.dumps({"runs": args.runs}))


if __name__ == "__main__":
    main()
