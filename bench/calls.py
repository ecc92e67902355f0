"""Python calls that one message, one service call and one goal cost two gateways, in order, by name.

Counted with ``sys.setprofile`` in both gateways while one warm sample of 1 kB passes, or one service call and its
answer, or one goal from its sending to its result. Several are counted one by one; the fewest calls are the figure, for
whatever else a gateway does meanwhile only adds to them. Counts do not depend on how busy the machine is.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import struct
import sys
import tempfile
import threading
from collections.abc import Awaitable, Callable, Sequence
from contextlib import AsyncExitStack
from pathlib import Path
from types import FrameType
from typing import Any, Final, NamedTuple

import uvloop

from bench.netns import Process
from bench.paper import config
from bench.report import table
from ropeway.aio import timeout
from ropeway.gateway.config.config import load
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import Sample
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.dds import DdsGraph
from ropeway.types import TypeRegistry

__all__ = ["ACTION_CALLS", "OPERATIONS", "READ_CALLS", "SERVICE_CALLS", "WRITE_CALLS", "Count", "measure"]

READ_CALLS: Final = 20
"""Calls from the DDS reader to the socket."""
WRITE_CALLS: Final = 10
"""Calls from the socket to the DDS writer."""
SERVICE_CALLS: Final = 145
"""Calls of both gateways for a service call, there and back."""
ACTION_CALLS: Final = 500
"""Calls of both gateways for a goal, from its sending to its result."""

DOMAIN_A, DOMAIN_B = 68, 69
TOPIC_TYPE, SERVICE_TYPE = "std_msgs/msg/UInt8MultiArray", "example_interfaces/srv/AddTwoInts"
ACTION_TYPE = "example_interfaces/action/Fibonacci"
_BEGIN: Final = b"+\n"
_HEAD: Final = b"\0\1\0\0"
_BODY_BYTES: Final = 1024
_SUM: Final = struct.Struct("<4sq")
_WARM: Final = 10
_SETTLE_S: Final = 0.05  # what a message leaves for the next turns of the event loop is counted as well
_WARM_S: Final = 2.5  # requests to a server that was matched just now are repeated
_WAIT_S: Final = 90.0  # a busy machine takes long until everybody has found everybody


class Count(NamedTuple):
    """The calls of one ``way`` of a message, as ``thread: module: function``; ``asked`` is how many it should take."""

    way: str
    calls: list[str]
    asked: int


# ── in a gateway ─────────────────────────────────────────────────────────────────────────────────────────────────


class Counter:
    """Notes the Python calls of all threads while it is told to, by lines on the standard input."""

    def __init__(self) -> None:
        self._on = False
        self._seen: list[tuple[str, str, str]] = []

    def profile(self, frame: FrameType, event: str, _: object) -> None:
        """Note a call; see ``sys.setprofile``."""
        if self._on and event == "call" and frame.f_code.co_filename != __file__:
            code = frame.f_code
            name = getattr(code, "co_qualname", code.co_name)  # of Python 3.11 and later
            self._seen.append((threading.current_thread().name, code.co_filename, name))

    def command(self) -> None:
        """Begin to count, or print what was counted."""
        if os.read(0, len(_BEGIN)) == _BEGIN:
            self._seen = []
            self._on = True
            os.write(1, b"\n")
        else:
            self._on = False
            seen = [f"{thread}: {_short(path)}: {name}" for thread, path, name in self._seen]
            os.write(1, json.dumps(seen).encode() + b"\n")


def _short(path: str) -> str:
    return path.partition("/src/ropeway/")[2] or Path(path).name


async def gateway(path: str) -> None:
    """A gateway whose calls are counted."""
    counter = Counter()
    threading.setprofile(counter.profile)
    sys.setprofile(counter.profile)
    async with Gateway(load(Path(path))) as running:
        asyncio.get_running_loop().add_reader(0, counter.command)
        os.write(1, b"up\n")
        await running.wait()


# ── around them ──────────────────────────────────────────────────────────────────────────────────────────────────


class Pair:
    """Two gateways: one on ``DOMAIN_A`` dials the other on ``DOMAIN_B``, with one route of each ``operation``."""

    def __init__(self, directory: Path, operations: Sequence[str], port: int) -> None:
        address = f"ws://127.0.0.1:{port}"
        a, b = (f"dds:{domain}?interface=lo" for domain in (DOMAIN_A, DOMAIN_B))
        items = {operation: [{"name": f"/{_name(operation)}", "type": _type(operation)}] for operation in operations}
        listens = config(directory, "listens", [], address, b)
        dials = config(directory, "dials", [{"address": address, **items}], None, a)
        self._gateways = [Process(None, "-m", "bench.calls", "gateway", path) for path in (dials, listens)]

    def up(self) -> None:
        """Wait until both are up."""
        for process in self._gateways:
            process.line()

    def begin(self) -> None:
        """Count from now on."""
        for process in self._gateways:
            process.tell("+")
            process.line()

    def end(self) -> list[list[str]]:
        """Return the calls of the gateway that dials, and of the one that listens."""
        for process in self._gateways:
            process.tell("-")
        return [json.loads(process.line()) for process in self._gateways]

    def stop(self) -> None:
        """End both."""
        for process in self._gateways:
            process.stop()

    async def count(self, one: Callable[[], Awaitable[None]], samples: int) -> list[list[str]]:
        """Return the fewest calls of both gateways while ``one`` runs."""
        for _ in range(_WARM):
            await one()
        counted = []
        for _ in range(samples):
            self.begin()
            await one()
            await asyncio.sleep(_SETTLE_S)
            counted.append(self.end())
        return [min(calls, key=len) for calls in zip(*counted, strict=True)]


def _name(operation: str) -> str:
    return f"counted_{operation.replace('-', '_')}"


def _type(operation: str) -> str:
    return SERVICE_TYPE if operation in _CALLS else ACTION_TYPE if operation in _GOALS else TOPIC_TYPE


async def _topic(pair: Pair, source: DdsGraph, sink: DdsGraph, name: str, samples: int) -> list[list[str]]:
    """Count one message from ``source`` to ``sink``."""
    publisher = await source.create_publisher(name, TOPIC_TYPE)
    arrived = asyncio.Event()
    subscription = await sink.create_subscription(name, TOPIC_TYPE, None, lambda _: arrived.set())
    sample = Sample(_HEAD + struct.pack("<III", 0, 0, _BODY_BYTES) + bytes(_BODY_BYTES), TOPIC_TYPE, 0, bytes(16), 0)

    async def one() -> None:
        arrived.clear()
        publisher.publish(sample)
        await arrived.wait()

    async with timeout(_WAIT_S):
        while not arrived.is_set():  # until everybody has found everybody
            publisher.publish(sample)
            await asyncio.sleep(_SETTLE_S)
        counted = await pair.count(one, samples)
    await subscription.close()
    await publisher.close()
    return counted


async def _service(pair: Pair, caller: DdsGraph, server: DdsGraph, name: str, samples: int) -> list[list[str]]:
    """Count one call of ``caller`` that ``server`` answers."""

    async def add(request: Request) -> bytes:
        return _SUM.pack(_HEAD, sum(struct.unpack_from("<qq", request.payload, len(_HEAD))))

    service = await server.create_service(name, SERVICE_TYPE, add)
    client = await caller.create_client(name, SERVICE_TYPE)
    if not await client.wait_available(_WAIT_S):
        raise SystemExit(f"nobody serves {name}")

    async def one() -> None:
        await client.call(Request(struct.pack("<4sqq", _HEAD, 2, 3)), _WAIT_S)

    await one()  # the gateways make their clients
    await asyncio.sleep(_WARM_S)
    counted = await pair.count(one, samples)
    await client.close()
    await service.close()
    return counted


async def _action(pair: Pair, sender: DdsGraph, server: DdsGraph, name: str, samples: int) -> list[list[str]]:
    """Count one goal of ``sender`` that ``server`` carries out at once."""

    async def succeed(goal: ServerGoal) -> Outcome:
        return Outcome(GoalStatus.SUCCEEDED, _HEAD + struct.pack("<I", 0))

    serving = await server.create_action_server(name, ACTION_TYPE, ActionHandlers(succeed))
    client = await sender.create_action_client(name, ACTION_TYPE)
    if not await client.wait_available(_WAIT_S):
        raise SystemExit(f"nobody serves {name}")

    async def one() -> None:
        goal = await client.send_goal(Goal(_HEAD + struct.pack("<i", 3)), timeout_s=_WAIT_S)
        await goal.result(_WAIT_S)

    await one()  # the gateways make their clients
    await asyncio.sleep(_WARM_S)
    counted = await pair.count(one, samples)
    await client.close()
    await serving.close()
    return counted


_INWARD: Final = (
    "subscribe",
    "expose-service",
    "expose-action",
)  # messages and calls come from the gateway that listens
_CALLS: Final = ("reserve-service", "expose-service")
_GOALS: Final = ("reserve-action", "expose-action")
OPERATIONS: Final = ("publish", "subscribe", *_CALLS, *_GOALS)


async def measure(operations: Sequence[str] = OPERATIONS, *, samples: int, port: int) -> list[Count]:
    """Count what one message or call costs, by operation of the gateway that dials."""
    counts: list[Count] = []
    async with AsyncExitStack() as stack:
        directory = stack.enter_context(tempfile.TemporaryDirectory())
        pair = Pair(Path(directory), operations, port)
        stack.callback(pair.stop)
        graphs = []
        for domain in (DOMAIN_A, DOMAIN_B):
            graph = DdsGraph(domain, name=f"counted_{domain}", interface="lo", registry=TypeRegistry())
            await graph.open()
            stack.push_async_callback(graph.close)
            graphs.append(graph)
        pair.up()
        for operation in operations:
            inward, name = operation in _INWARD, f"/{_name(operation)}"
            begins, ends = reversed(graphs) if inward else graphs
            count = _service if operation in _CALLS else _action if operation in _GOALS else _topic
            near, far = await count(pair, begins, ends, name, samples)
            if inward:
                near, far = far, near
            if operation in (*_CALLS, *_GOALS):
                asked = SERVICE_CALLS if operation in _CALLS else ACTION_CALLS
                counts.append(Count(f"{operation}: there and back", near + far, asked))
            else:
                counts.append(Count(f"{operation}: DDS reader to socket", near, READ_CALLS))
                counts.append(Count(f"{operation}: socket to DDS writer", far, WRITE_CALLS))
    return counts


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("role", choices=["measure", "gateway"], nargs="?", default="measure")
    parser.add_argument("path", nargs="?", default="")
    parser.add_argument("--only", default="", help=f"some of {', '.join(OPERATIONS)}")
    parser.add_argument("--samples", type=int, default=20)
    parser.add_argument("--port", type=int, default=19494)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.role == "gateway":
        uvloop.run(gateway(args.path))
        return
    operations = args.only.split(",") if args.only else OPERATIONS
    counts = uvloop.run(measure(operations, samples=args.samples, port=args.port))
    rows: list[list[Any]] = [[count.way, len(count.calls), count.asked] for count in counts]
    table("Python calls of one warm message", ["way", "calls", "asked"], rows, as_json=args.json)
    if args.json:
        return
    for count in counts:
        print(f"\n{count.way}")
        for number, call in enumerate(count.calls, 1):
            print(f"{number:4}  {call}")


if __name__ == "__main__":
    main()
