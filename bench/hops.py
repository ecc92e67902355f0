"""Where the time of one service call goes, hop by hop: from its caller through two gateways to its server and back.

Nodes of ours in two DDS domains call each other through two gateways on this machine. All four processes note the time
(one clock) at which a call passes certain functions; calls are made one after the other, and the medians of the times
between one note and the next are the figures. A note costs less than a microsecond.
"""

from __future__ import annotations

import argparse
import asyncio
import functools
import json
import os
import statistics
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import AsyncExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import uvloop

from bench.netns import Process
from bench.paper import config
from bench.report import table
from ropeway.gateway.config.config import load
from ropeway.gateway.gateway import Gateway
from ropeway.graph.calls import Request
from ropeway.graph.hand_over import HandOver
from ropeway.listener.connection import Connection
from ropeway.networks.dds import DdsGraph
from ropeway.networks.dds.client import DdsClient
from ropeway.networks.dds.raw_endpoints import RawReader, RawWriter
from ropeway.types import TypeRegistry

DOMAIN_NEAR, DOMAIN_FAR, PORT = 70, 71, 19595
SERVICE, TYPE = "/hops", "example_interfaces/srv/AddTwoInts"
_HEAD: Final = b"\0\1\0\0"
_PAIR: Final = struct.Struct("<4sqq")
_SUM: Final = struct.Struct("<4sq")
_WARM: Final = 100
_WARM_S: Final = 2.5  # requests to a server that was matched just now are repeated
_PAUSE_S: Final = 0.002  # between calls: what is left of one does not delay the next
_PASSED: Final[tuple[tuple[type, str, str], ...]] = (
    (RawReader, "on_data", "reader thread wakes"),
    (HandOver, "_drain", "event loop takes it from the thread"),
    (Connection, "on_ws_frame", "event loop reads the socket"),
)
_DONE: Final[tuple[tuple[type, str, str], ...]] = (
    (Connection, "send_binary", "is on the socket"),
    (RawWriter, "write", "is given to DDS"),
)
_NAMES: Final = ("caller", "near", "far", "server")


class Notes:
    """When a call passed which function of this process; printed at the end."""

    def __init__(self) -> None:
        self.rows: list[tuple[int, str]] = []
        for owner, name, label in _PASSED:
            self._wrap(owner, name, label, first=True)
        for owner, name, label in _DONE:
            self._wrap(owner, name, label, first=False)

    def note(self, label: str) -> None:
        """Note that a call is here now."""
        self.rows.append((time.monotonic_ns(), label))

    def _wrap(self, owner: type, name: str, label: str, *, first: bool) -> None:
        inner: Callable[..., Any] = getattr(owner, name)

        @functools.wraps(inner)
        def passing(*args: Any, **options: Any) -> Any:
            if first:
                self.note(label)
                return inner(*args, **options)
            result = inner(*args, **options)
            self.note(label)
            return result

        setattr(owner, name, passing)

    def tell(self) -> None:
        """Print the notes."""
        print(json.dumps(self.rows), flush=True)


async def _ended() -> None:
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)


async def gateway(path: str) -> None:
    """A gateway that notes."""
    notes = Notes()
    async with Gateway(load(Path(path))):
        os.write(1, b"up\n")
        await _ended()
        notes.tell()


async def server(domain: int) -> None:
    """A node that adds."""
    notes = Notes()

    async def add(request: Request) -> bytes:
        _, a, b = _PAIR.unpack(request.payload)
        return _SUM.pack(_HEAD, a + b)

    graph = DdsGraph(domain, name="adder", interface="lo", registry=TypeRegistry())
    await graph.open()
    await graph.create_service(SERVICE, TYPE, add)
    print("up", flush=True)
    await _ended()
    notes.tell()
    await graph.close()


async def caller(domain: int, calls: int) -> None:
    """A node that has things added."""
    notes = Notes()
    graph = DdsGraph(domain, name="caller", interface="lo", registry=TypeRegistry())
    await graph.open()
    client: DdsClient = await graph.create_client(SERVICE, TYPE)
    if not await client.wait_available(20):
        raise SystemExit(f"nobody serves {SERVICE}")

    async def call(i: int) -> None:
        notes.note("calls")
        await client.call(Request(_PAIR.pack(_HEAD, i, i)), 20)
        notes.note("has the answer")
        await asyncio.sleep(_PAUSE_S)

    for i in range(_WARM):
        await call(i)
    await asyncio.sleep(_WARM_S)
    for i in range(calls):
        await call(i)
    notes.tell()
    await graph.close()


async def measure(calls: int) -> list[tuple[str, float]]:
    """Return the hops of a call, and the microseconds that each takes."""
    async with AsyncExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        address = f"ws://127.0.0.1:{PORT}"
        route = {"address": address, "reserve-service": [{"name": SERVICE, "type": TYPE}]}
        near = config(directory, "near", [route], None, f"dds:{DOMAIN_NEAR}?interface=lo")
        far = config(directory, "far", [], address, f"dds:{DOMAIN_FAR}?interface=lo")
        commands = (("gateway", near), ("gateway", far), ("server", f"--domain={DOMAIN_FAR}"))
        running = []
        for words in commands:
            running.append(Process(None, "-m", "bench.hops", *words))
            stack.callback(running[-1].stop)
        for process in running:
            process.line()
        caller = Process(None, "-m", "bench.hops", "caller", f"--domain={DOMAIN_NEAR}", f"--calls={calls}")
        stack.callback(caller.stop)
        told = [caller.line()]
        for process in running:
            process.tell()
            told.append(process.line())
    notes = sorted(
        (at_ns, f"{name}: {label}")
        for name, rows in zip(_NAMES, told, strict=True)
        for at_ns, label in json.loads(rows)
    )
    return _hops(sorted(notes), calls)


def _hops(notes: list[tuple[int, str]], calls: int) -> list[tuple[str, float]]:
    """Return the steps of most calls, and the medians of how long they took."""
    ways: list[list[tuple[int, str]]] = []
    for at_ns, label in notes:
        if label == "caller: calls":
            ways.append([])
        if ways:
            ways[-1].append((at_ns, label))
            if label == "caller: has the answer":
                ways.append([])
    ways = [way for way in ways if way and way[0][1] == "caller: calls"][-calls:]
    usual, _ = Counter(tuple(label for _, label in way) for way in ways).most_common(1)[0]
    times = [[at_ns for at_ns, _ in way] for way in ways if tuple(label for _, label in way) == usual]
    steps = zip(*[[after - before for before, after in pairwise(row)] for row in times], strict=True)
    found = [(label, statistics.median(step) / 1e3) for label, step in zip(usual[1:], steps, strict=True)]
    whole = statistics.median(row[-1] - row[0] for row in times) / 1e3
    return [*found, (f"in all, {len(times)} of {len(ways)} calls went so", whole)]


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("role", choices=["measure", "gateway", "server", "caller"], nargs="?", default="measure")
    parser.add_argument("path", nargs="?", default="")
    parser.add_argument("--domain", type=int, default=DOMAIN_NEAR)
    parser.add_argument("--calls", type=int, default=1000)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.role == "measure":
        rows = [[hop, took_us] for hop, took_us in uvloop.run(measure(args.calls))]
        table("one service call, hop by hop", ["hop", "us"], rows, as_json=args.json)
    elif args.role == "caller":
        uvloop.run(caller(args.domain, args.calls))
    else:
        uvloop.run(gateway(args.path) if args.role == "gateway" else server(args.domain))


if __name__ == "__main__":
    main()
