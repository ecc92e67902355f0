"""Service calls and goals through two gateways on one machine: round trips, calls at once, and calls beside images.

Nodes in one DDS domain call a service and an action of another, and two gateways join the domains. With a sourced ROS 2
the ends are rclpy on Cyclone DDS, otherwise (or with ``--ends dds``) ours. Beside it stands the same within one domain,
which is the least that it can take. ``--before DIRECTORY`` measures another checkout in turns, ``--peer NAME NEAR FAR``
gateways of another make by their commands, in which ``{domain}`` and ``{port}`` are filled in::

    python -m bench.services --before ../before
    python -m bench.services --peer bridge "BRIDGE -d {domain} -l tcp/127.0.0.1:{port}" \
        "BRIDGE -d {domain} -e tcp/127.0.0.1:{port}"

A goal is *accepted* when its sender knows so, and *ended* when the sender has the result. *At once* keeps so many calls
under way. What is *lost* was not answered in time, or wrongly.
"""

from __future__ import annotations

import argparse
import asyncio
import importlib.util
import json
import os
import statistics
import struct
import sys
import tempfile
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from bench.images import IMAGE
from bench.netns import ROS_ENVIRONMENT, Process, ros_bridge
from bench.paper import config
from bench.report import table
from ropeway import aio
from ropeway.errors import CallError
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.dds import DdsGraph
from ropeway.types import TypeRegistry

DOMAIN_NEAR, DOMAIN_FAR, PORT = 64, 65, 19393
SERVICE, TYPE = "/add", "example_interfaces/srv/AddTwoInts"
ACTION, ACTION_TYPE = "/count", "example_interfaces/action/Fibonacci"
IMAGES: Final = "/images"
_PAIR: Final = struct.Struct("<4sqq")
_SUM: Final = struct.Struct("<4sq")
_ORDER: Final = struct.Struct("<4si")
_HEAD: Final = b"\0\1\0\0"
_WARM: Final = 50
_WARM_S: Final = 2.5  # requests to a server that was matched just now are repeated
_WAIT_S: Final = 20.0
_STALL_S: Final = 2.0  # a node of ROS 2 loses what its reader has no room for
_IMAGE_HZ: Final = 60


# ── the ends ─────────────────────────────────────────────────────────────────────────────────────────────────────


class Caller(Protocol):
    """Calls the service and the action."""

    async def add(self, a: int, b: int) -> bool:
        """Call the service; return whether the sum is right."""
        ...

    async def count(self, order: int) -> tuple[float, bool]:
        """Send a goal; return when it was accepted, and whether its result is right."""
        ...

    async def flood(self, calls: int, at_once: int) -> tuple[int, float]:
        """Make many calls, so many at a time; return how many were answered, and in how many seconds."""
        ...


class DdsCaller:
    """Calls with a graph of ours."""

    async def open(self, domain: int) -> None:
        """Find who serves."""
        graph = DdsGraph(domain, name="caller", interface="lo", registry=TypeRegistry())
        await graph.open()
        self._service = await graph.create_client(SERVICE, TYPE)
        self._action = await graph.create_action_client(ACTION, ACTION_TYPE)
        for client, name in ((self._service, SERVICE), (self._action, ACTION)):
            if not await client.wait_available(_WAIT_S):
                raise SystemExit(f"nobody serves {name}")

    async def add(self, a: int, b: int) -> bool:
        """See ``Caller``."""
        try:
            answer = await self._service.call(Request(_PAIR.pack(_HEAD, a, b)), _WAIT_S)
        except CallError:
            return False
        return bool(_SUM.unpack(answer)[1] == a + b)

    async def count(self, order: int) -> tuple[float, bool]:
        """See ``Caller``."""
        try:
            goal = await self._action.send_goal(Goal(_ORDER.pack(_HEAD, order)), timeout_s=_WAIT_S)
            accepted = time.perf_counter()
            outcome = await goal.result(_WAIT_S)
        except CallError:
            return float("nan"), False
        right = outcome.status is GoalStatus.SUCCEEDED and outcome.payload is not None
        return accepted, right and struct.unpack_from("<I", outcome.payload or b"", 4)[0] == order

    async def flood(self, calls: int, at_once: int) -> tuple[int, float]:
        """See ``Caller``."""
        numbers = iter(range(calls))
        began = time.monotonic()

        async def some() -> int:
            return sum([await self.add(i, 7 * i) for i in numbers])

        answered = sum(await asyncio.gather(*(some() for _ in range(at_once))))
        return answered, time.monotonic() - began


class RosCaller:
    """Calls with rclpy."""

    async def open(self, domain: int) -> None:
        """Find who serves."""
        import rclpy
        from example_interfaces.action import Fibonacci
        from example_interfaces.srv import AddTwoInts
        from rclpy.action import ActionClient
        from rclpy.executors import SingleThreadedExecutor

        rclpy.init(domain_id=domain)
        node = rclpy.create_node("caller")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._request, self._goal = AddTwoInts.Request, Fibonacci.Goal
        self._service = node.create_client(AddTwoInts, SERVICE)
        self._action = ActionClient(node, Fibonacci, ACTION)
        if not (self._service.wait_for_service(_WAIT_S) and self._action.wait_for_server(_WAIT_S)):
            raise SystemExit("nobody serves")

    def _wait(self, future: Any) -> Any:
        until = time.monotonic() + _WAIT_S
        while not future.done() and time.monotonic() < until:
            self._executor.spin_once(_WAIT_S)  # spin_until_future_complete slows down with each call
        return future.result() if future.done() else None

    async def add(self, a: int, b: int) -> bool:
        """See ``Caller``."""
        answer = self._wait(self._service.call_async(self._request(a=a, b=b)))
        return answer is not None and bool(answer.sum == a + b)

    async def count(self, order: int) -> tuple[float, bool]:
        """See ``Caller``."""
        goal = self._wait(self._action.send_goal_async(self._goal(order=order)))
        accepted = time.perf_counter()
        if goal is None or not goal.accepted:
            return float("nan"), False
        outcome = self._wait(goal.get_result_async())
        return accepted, outcome is not None and len(outcome.result.sequence) == order

    async def flood(self, calls: int, at_once: int) -> tuple[int, float]:
        """See ``Caller``."""
        sent = answered = 0
        began = time.monotonic()

        def ask() -> None:
            nonlocal sent
            sent += 1
            self._service.call_async(self._request(a=sent, b=sent)).add_done_callback(lambda _: count())

        def count() -> None:
            nonlocal answered
            answered += 1
            if sent < calls:
                ask()

        for _ in range(at_once):
            ask()
        moved, seen = time.monotonic(), 0
        while answered < sent and time.monotonic() - moved < _STALL_S:
            self._executor.spin_once(0.1)
            if answered != seen:
                moved, seen = time.monotonic(), answered
        return answered, moved - began  # waiting for those that are lost does not count


async def call(args: argparse.Namespace) -> None:
    """Do what is asked for by lines of the standard input, and print how long it took."""
    caller: DdsCaller | RosCaller = RosCaller() if args.ends == "rclpy" else DdsCaller()
    await caller.open(args.domain)
    for i in range(_WARM):
        await caller.add(i, i)
    await asyncio.sleep(_WARM_S)
    await caller.count(1)
    print("ready", flush=True)
    while what := sys.stdin.readline().strip():
        if what == "calls":
            figures = await _timed(args.calls, lambda i: _call_once(caller, i))
        elif what == "goals":
            figures = await _timed(args.goals, lambda i: caller.count(i % 10))
        else:
            answered, took_s = await caller.flood(args.flood, args.at_once)
            figures = {"calls_per_s": answered / took_s, "answered": answered, "lost": args.flood - answered}
        print(json.dumps(figures), flush=True)
    os._exit(0)  # a node that is taken down properly takes a second or two


async def _call_once(caller: Caller, i: int) -> tuple[float, bool]:
    return time.perf_counter(), await caller.add(i, 2 * i)


async def _timed(number: int, one: Callable[[int], Awaitable[tuple[float, bool]]]) -> dict[str, float]:
    """Return the percentiles of how long it took, one after the other."""
    times, lost = [], 0
    for i in range(number):
        began = time.perf_counter()
        accepted, right = await one(i)
        lost += not right
        if right:
            times.append((1e3 * (accepted - began), 1e3 * (time.perf_counter() - began)))
    rows = np.array(times or [(float("nan"),) * 2])
    accepted_ms, p50, p99 = np.median(rows[:, 0]), *np.percentile(rows[:, 1], [50, 99])
    return {"accepted": float(accepted_ms), "p50": float(p50), "p99": float(p99), "lost": lost}


async def serve(args: argparse.Namespace) -> None:
    """Add, and count up to a number as an action."""
    if args.ends == "rclpy":
        _serve_with_rclpy(args.domain)

    async def add(request: Request) -> bytes:
        _, a, b = _PAIR.unpack(request.payload)
        return _SUM.pack(_HEAD, a + b)

    async def count(goal: ServerGoal) -> Outcome:
        numbers = range(_ORDER.unpack(goal.payload)[1])
        return Outcome(GoalStatus.SUCCEEDED, _HEAD + struct.pack(f"<I{len(numbers)}i", len(numbers), *numbers))

    graph = DdsGraph(args.domain, name="adder", interface="lo", registry=TypeRegistry())
    await graph.open()
    await graph.create_service(SERVICE, TYPE, add)
    await graph.create_action_server(ACTION, ACTION_TYPE, ActionHandlers(count))
    print("ready", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    await graph.close()


def _serve_with_rclpy(domain: int) -> None:
    import rclpy
    from example_interfaces.action import Fibonacci
    from example_interfaces.srv import AddTwoInts
    from rclpy.action import ActionServer

    rclpy.init(domain_id=domain)
    node = rclpy.create_node("adder")

    def add(request: Any, response: Any) -> Any:
        response.sum = request.a + request.b
        return response

    def count(goal: Any) -> Any:
        goal.succeed()
        return Fibonacci.Result(sequence=list(range(goal.request.order)))

    def end() -> None:
        sys.stdin.readline()
        os._exit(0)

    node.create_service(AddTwoInts, SERVICE, add)
    server = ActionServer(node, Fibonacci, ACTION, count)
    threading.Thread(target=end, daemon=True).start()
    print("ready", flush=True)
    rclpy.spin(node)
    server.destroy()


# ── around them ──────────────────────────────────────────────────────────────────────────────────────────────────


class Subject(NamedTuple):
    """What joins the two domains: commands of two gateways, our gateways (of another checkout), or nothing."""

    name: str
    near: str = ""
    far: str = ""
    directory: str = ""
    operation: str = "reserve"
    encoding: str = "auto"

    @property
    def far_domain(self) -> int:
        """Return the domain of who serves, which is the caller's where nothing is between the two."""
        return DOMAIN_FAR if self.operation else DOMAIN_NEAR

    def start(self, directory: Path) -> Iterator[Process]:
        """Start the gateway that the caller is at, and the other."""
        if not self.operation:
            return
        if self.near:
            for command, domain in ((self.near, DOMAIN_NEAR), (self.far, DOMAIN_FAR)):
                yield ros_bridge(command, domain, PORT)
            return
        address = f"ws://127.0.0.1:{PORT}"
        reserves = self.operation == "reserve"
        route = {
            "address": address,
            f"{self.operation}-service": [{"name": SERVICE, "type": TYPE, "compression": self.encoding}],
            f"{self.operation}-action": [{"name": ACTION, "type": ACTION_TYPE, "compression": self.encoding}],
            "publish" if reserves else "subscribe": [{"name": IMAGES, "type": IMAGE}],
        }
        ends = [("near", DOMAIN_NEAR, reserves), ("far", DOMAIN_FAR, not reserves)]
        environment = {"PYTHONPATH": str(Path(self.directory) / "src")} if self.directory else {}
        for name, domain, dials in ends:
            graph = f"dds:{domain}?interface=lo"
            path = config(directory, name, [route] if dials else [], None if dials else address, graph)
            yield Process(None, "-m", "ropeway", "run", path, "--quiet", **environment)


class Figures(NamedTuple):
    """What one run shows: milliseconds, calls a second, and what both gateways need for a call, in microseconds."""

    p50_ms: float
    p99_ms: float
    accepted_ms: float
    ended_ms: float
    calls_hz: float
    cpu_us: float
    beside_p50_ms: float
    beside_p99_ms: float
    lost: float


def measure(subject: Subject, args: argparse.Namespace) -> Figures:
    """Return what one run shows."""
    with tempfile.TemporaryDirectory() as directory, ExitStack() as stack:

        def start(*words: str, domain: int) -> Process:
            process = Process(None, "-m", *words, **ROS_ENVIRONMENT, ROS_DOMAIN_ID=str(domain))
            stack.callback(process.stop)
            return process

        gateways = []
        for process in subject.start(Path(directory)):
            stack.callback(process.stop)
            gateways.append(process)
        mine = ("bench.services", f"--ends={args.ends}")
        server = start(*mine, "serve", f"--domain={subject.far_domain}", domain=subject.far_domain)
        server.line()
        amounts = [f"--{name}={getattr(args, name.replace('-', '_'))}" for name in _AMOUNTS]
        caller = start(*mine, "call", f"--domain={DOMAIN_NEAR}", *amounts, domain=DOMAIN_NEAR)
        if not caller.line():
            raise SystemExit(f"{subject.name}: nobody answers")

        def ask(what: str) -> dict[str, float]:
            caller.tell(what)
            figures: dict[str, float] = json.loads(caller.line())
            return figures

        calls, goals = ask("calls"), ask("goals")
        used_s = sum(process.cpu_s() for process in gateways)
        flood = ask("flood")
        cpu_us = 1e6 * (sum(process.cpu_s() for process in gateways) - used_s) / max(flood["answered"], 1)
        seconds = f"--seconds={args.image_s}"
        topic = (f"--topic={IMAGES}", "--kind=rgb", seconds)
        sink = start("bench.peers", "sink", *topic, f"--domain={subject.far_domain}", domain=subject.far_domain)
        sink.line()
        source = start(
            "bench.peers", "source", *topic, f"--domain={DOMAIN_NEAR}", f"--hz={_IMAGE_HZ}", domain=DOMAIN_NEAR
        )
        source.line()
        beside = ask("calls")
    lost = calls["lost"] + goals["lost"] + flood["lost"] + beside["lost"]
    times = calls["p50"], calls["p99"], goals["accepted"], goals["p50"]
    return Figures(*times, flood["calls_per_s"], cpu_us, beside["p50"], beside["p99"], lost)


_AMOUNTS: Final = ("calls", "goals", "flood", "at-once")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("role", choices=["measure", "serve", "call"], nargs="?", default="measure")
    parser.add_argument("--domain", type=int, default=DOMAIN_NEAR)
    parser.add_argument("--calls", type=int, default=1000)
    parser.add_argument("--goals", type=int, default=300)
    parser.add_argument("--flood", type=int, default=3000, help="calls, of which --at-once are under way")
    parser.add_argument("--at-once", type=int, default=100)
    parser.add_argument("--image-s", type=float, default=10)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--routes", default="reserve:auto", help="operations and encodings, as reserve:zip,expose:auto")
    parser.add_argument(
        "--ends", choices=["rclpy", "dds"], default="rclpy" if importlib.util.find_spec("rclpy") else "dds"
    )
    parser.add_argument("--before", default="", help="another checkout, measured in turns")
    parser.add_argument("--peer", nargs=3, action="append", default=[], metavar=("NAME", "NEAR", "FAR"))
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.role != "measure":
        with aio.Runner(loop_factory=_loop) as runner:
            runner.run({"serve": serve, "call": call}[args.role](args))
        return
    subjects = [Subject("none", operation="")]
    if args.before:
        subjects.append(Subject("before", directory=args.before))
    for route in args.routes.split(","):
        operation, _, encoding = route.partition(":")
        subjects.append(Subject(f"ropeway {route}", operation=operation, encoding=encoding or "auto"))
    subjects.extend(Subject(*words) for words in args.peer)
    runs: dict[str, list[Figures]] = {subject.name: [] for subject in subjects}
    for _ in range(args.runs):
        for subject in subjects:
            runs[subject.name].append(measure(subject, args))
    rows = [[name, *map(statistics.median, zip(*figures, strict=True))] for name, figures in runs.items()]
    heads = ["gateways", "call p50 ms", "p99", "goal accepted p50 ms", "ended", f"{args.at_once} at once, calls/s"]
    heads += ["CPU us per call", f"beside images at {_IMAGE_HZ} Hz: p50 ms", "p99", "lost"]
    table(f"service calls and goals, ends by {args.ends}", heads, rows, as_json=args.json)


def _loop() -> asyncio.AbstractEventLoop:
    import uvloop

    return uvloop.new_event_loop()


if __name__ == "__main__":
    main()
