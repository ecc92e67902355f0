"""Service calls over a gateway pair on loopback beside the same calls made directly over DDS.

The round trip of calls one after the other, and a thousand calls at once: every one answered, each with its own sum.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import struct
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import uvloop

from bench.netns import Process
from bench.paper import config
from bench.report import table
from ropeway.errors import CallError
from ropeway.graph.calls import Request
from ropeway.networks.dds import DdsGraph
from ropeway.types import TypeRegistry

DOMAIN_A, DOMAIN_B, PORT = 64, 65, 19393
TYPE = "example_interfaces/srv/AddTwoInts"
PAIR = struct.Struct("<4sqq")
SUM = struct.Struct("<4sq")
HEAD = b"\0\1\0\0"


async def serve(args: argparse.Namespace) -> None:
    """A node that adds."""

    async def add(request: Request) -> bytes:
        _, a, b = PAIR.unpack(request.payload)
        return SUM.pack(HEAD, a + b)

    graph = DdsGraph(args.domain, name="adder", interface="lo", registry=TypeRegistry())
    await graph.open()
    await graph.create_service("/add", TYPE, add)
    print("ready", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    await graph.close()


async def call(args: argparse.Namespace) -> None:
    """A node that has things added; prints how long it took."""
    graph = DdsGraph(args.domain, name="caller", interface="lo", registry=TypeRegistry())
    await graph.open()
    client = await graph.create_client("/add", TYPE)
    if not await client.wait_available(15):
        raise SystemExit("nobody serves /add")
    lost = 0

    async def one(a: int, b: int) -> float:
        nonlocal lost
        began = time.perf_counter()
        try:
            answer = await client.call(Request(PAIR.pack(HEAD, a, b)), 20)
        except CallError:
            lost += 1
            return float("nan")
        if SUM.unpack(answer)[1] != a + b:
            lost += 1
        return time.perf_counter() - began

    for i in range(50):
        await one(i, i)
    lost = 0
    times = [await one(i, 2 * i) for i in range(args.calls)]
    one_by_one = lost
    lost, began = 0, time.perf_counter()
    await asyncio.gather(*(one(i, 7 * i) for i in range(args.at_once)))
    took = time.perf_counter() - began
    p50, p99 = np.nanpercentile(times, [50, 99])
    figures = {"p50_ms": 1e3 * p50, "p99_ms": 1e3 * p99, "lost": one_by_one, "burst_lost": lost, "burst_s": took}
    print(json.dumps({k: float(v) for k, v in figures.items()}), flush=True)
    await graph.close()


def gateways(directory: Path, operation: str, encoding: str) -> list[Process]:
    """A pair that brings /add of domain B to domain A: reserved by A's gateway, or exposed by B's."""
    item = {"name": "/add", "type": TYPE, "compression": encoding}
    remotes = [{"address": f"ws://127.0.0.1:{PORT}", operation: [item]}]
    a, b = (f"dds:{domain}?interface=lo" for domain in (DOMAIN_A, DOMAIN_B))
    listener, dialler = (b, a) if operation == "reserve-service" else (a, b)
    listens = config(directory, "listens", [], f"ws://127.0.0.1:{PORT}", listener)
    dials = config(directory, "dials", remotes, None, dialler)
    return [Process(None, "-m", "ropeway", "run", path, "--quiet") for path in (listens, dials)]


def measure(operation: str | None, encoding: str, calls: int, at_once: int) -> dict[str, float]:
    """Figures of the caller; without an operation the caller and the server share a domain."""
    me = ("-m", "bench.services")
    with tempfile.TemporaryDirectory() as directory:
        server = Process(None, *me, "serve", "--domain", str(DOMAIN_B))
        server.line()
        running = gateways(Path(directory), operation, encoding) if operation else []
        domain = DOMAIN_A if operation else DOMAIN_B
        caller = Process(
            None, *me, "call", "--domain", str(domain), "--calls", str(calls), "--at-once", str(at_once), quiet=False
        )
        figures: dict[str, float] = json.loads(caller.finish(120).splitlines()[-1])
        for process in (*running, server):
            process.stop()
    return figures


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("role", choices=["measure", "serve", "call"], nargs="?", default="measure")
    parser.add_argument("--domain", type=int, default=DOMAIN_A)
    parser.add_argument("--calls", type=int, default=1000)
    parser.add_argument("--at-once", type=int, default=1000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.role != "measure":
        uvloop.run({"serve": serve, "call": call}[args.role](args))
        return
    rows: list[list[Any]] = []
    for operation, encoding in (
        ("reserve-service", "auto"),
        ("expose-service", "auto"),
        ("reserve-service", "none"),
        ("reserve-service", "zip"),
    ):
        direct = measure(None, "", args.calls, args.at_once)
        over = measure(operation, encoding, args.calls, args.at_once)
        rows.append(
            [
                operation,
                encoding,
                direct["p50_ms"],
                over["p50_ms"],
                over["p50_ms"] / direct["p50_ms"],
                over["p99_ms"],
                int(over["lost"] + over["burst_lost"]),
                direct["burst_s"],
                over["burst_s"],
            ]
        )
    heads = ["operation", "encoding", "direct p50 ms", "pair p50", "ratio (<= 3)", "pair p99", "lost"]
    heads += [f"direct, {args.at_once} at once, s", "pair"]
    table("service calls", heads, rows, as_json=args.json)


if __name__ == "__main__":
    main()
