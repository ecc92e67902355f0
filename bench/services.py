"""Service calls and goals over a gateway pair on loopback beside the same made directly over DDS.

The round trip of calls one after the other, and a thousand calls at once: every one answered, each with its own sum. Of
an action, the time from sending a goal to its acceptance and to its result, one goal after the other.
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
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.dds import DdsGraph
from ropeway.types import TypeRegistry

DOMAIN_A, DOMAIN_B, PORT = 64, 65, 19393
TYPE = "example_interfaces/srv/AddTwoInts"
ACTION_TYPE = "example_interfaces/action/Fibonacci"
PAIR = struct.Struct("<4sqq")
SUM = struct.Struct("<4sq")
ORDER = struct.Struct("<4si")
HEAD = b"\0\1\0\0"


async def serve(args: argparse.Namespace) -> None:
    """A node that adds, and counts up to a number as an action."""

    async def add(request: Request) -> bytes:
        _, a, b = PAIR.unpack(request.payload)
        return SUM.pack(HEAD, a + b)

    async def count(goal: ServerGoal) -> Outcome:
        numbers = range(ORDER.unpack(goal.payload)[1])
        return Outcome(GoalStatus.SUCCEEDED, HEAD + struct.pack(f"<I{len(numbers)}i", len(numbers), *numbers))

    graph = DdsGraph(args.domain, name="adder", interface="lo", registry=TypeRegistry())
    await graph.open()
    await graph.create_service("/add", TYPE, add)
    await graph.create_action_server("/count", ACTION_TYPE, ActionHandlers(count))
    print("ready", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    await graph.close()


async def send_goals(graph: DdsGraph, goals: int) -> dict[str, float]:
    """Send goals one after the other; return the medians of their times and how many ended wrong."""
    client = await graph.create_action_client("/count", ACTION_TYPE)
    if not await client.wait_available(15):
        raise SystemExit("nobody serves /count")
    times, lost = [], 0
    for i in range(20 + goals):
        began = time.perf_counter()
        try:
            goal = await client.send_goal(Goal(ORDER.pack(HEAD, i % 10)), timeout_s=20)
            accepted = time.perf_counter()
            outcome = await goal.result(20)
        except CallError:
            lost += 1
            continue
        times.append((accepted - began, time.perf_counter() - began))
        payload = outcome.payload or bytes(8)
        lost += outcome.status is not GoalStatus.SUCCEEDED or struct.unpack_from("<I", payload, 4)[0] != i % 10
    accepted_s, ended_s = np.median(np.array(times[20:]), axis=0)
    return {"accepted_p50_ms": 1e3 * accepted_s, "goal_p50_ms": 1e3 * ended_s, "goals_lost": lost}


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
    figures |= await send_goals(graph, args.goals)
    print(json.dumps({k: float(v) for k, v in figures.items()}), flush=True)
    await graph.close()


def gateways(directory: Path, operation: str, encoding: str) -> list[Process]:
    """A pair that brings /add and /count of domain B to domain A: reserved by A's gateway, or exposed by B's."""
    service = {"name": "/add", "type": TYPE, "compression": encoding}
    action = {"name": "/count", "type": ACTION_TYPE, "compression": encoding}
    remotes = [
        {
            "address": f"ws://127.0.0.1:{PORT}",
            f"{operation}-service": [service],
            f"{operation}-action": [action],
        }
    ]
    a, b = (f"dds:{domain}?interface=lo" for domain in (DOMAIN_A, DOMAIN_B))
    listener, dialler = (b, a) if operation == "reserve" else (a, b)
    listens = config(directory, "listens", [], f"ws://127.0.0.1:{PORT}", listener)
    dials = config(directory, "dials", remotes, None, dialler)
    return [Process(None, "-m", "ropeway", "run", path, "--quiet") for path in (listens, dials)]


def measure(operation: str | None, encoding: str, args: argparse.Namespace) -> dict[str, float]:
    """Figures of the caller; without an operation the caller and the server share a domain."""
    me = ("-m", "bench.services")
    with tempfile.TemporaryDirectory() as directory:
        server = Process(None, *me, "serve", "--domain", str(DOMAIN_B))
        server.line()
        running = gateways(Path(directory), operation, encoding) if operation else []
        domain = DOMAIN_A if operation else DOMAIN_B
        amounts = ("--calls", str(args.calls), "--at-once", str(args.at_once), "--goals", str(args.goals))
        caller = Process(None, *me, "call", "--domain", str(domain), *amounts, quiet=False)
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
    parser.add_argument("--goals", type=int, default=300)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.role != "measure":
        uvloop.run({"serve": serve, "call": call}[args.role](args))
        return
    rows: list[list[Any]] = []
    for operation, encoding in (
        ("reserve", "auto"),
        ("expose", "auto"),
        ("reserve", "none"),
        ("reserve", "zip"),
    ):
        direct = measure(None, "", args)
        over = measure(operation, encoding, args)
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
                direct["goal_p50_ms"],
                over["accepted_p50_ms"],
                over["goal_p50_ms"],
                int(over["goals_lost"]),
            ]
        )
    heads = ["operation", "encoding", "direct p50 ms", "pair p50", "ratio (<= 3)", "pair p99", "lost"]
    heads += [f"direct, {args.at_once} at once, s", "pair"]
    heads += ["goal direct p50 ms", "pair accepted p50", "pair goal p50", "goals lost"]
    table("service calls and goals", heads, rows, as_json=args.json)


if __name__ == "__main__":
    main()
