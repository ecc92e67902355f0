"""Small messages through two gateways on one machine: delivered, delay, processor time, and what wakes.

A publisher and a subscriber of ROS 2 (rclpy, reliable, depth 10) are in two DDS domains, which two gateways join. With
a sourced ROS 2 the ends are rclpy on Cyclone DDS, otherwise (or with ``--ends dds``) ours. ``--before DIRECTORY``
measures another checkout in turns, ``--peer NAME NEAR FAR`` gateways of another make by their commands, in which
``{domain}`` and ``{port}`` are filled in::

    python -m bench.small --before ../before
    python -m bench.small --peer bridge "BRIDGE -d {domain} -l tcp/127.0.0.1:{port}" \
        "BRIDGE -d {domain} -e tcp/127.0.0.1:{port}"
"""

from __future__ import annotations

import argparse
import asyncio
import importlib.util
import json
import os
import select
import statistics
import struct
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from bench.netns import ROS_ENVIRONMENT, Process, ros_bridge
from bench.paper import config
from bench.report import table
from ropeway import aio
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.networks.dds import DdsGraph
from ropeway.qos import QoS

DOMAIN_NEAR, DOMAIN_FAR, PORT = 66, 67, 19191
TYPE, TOPIC = "std_msgs/msg/UInt8MultiArray", "/small"
_HEAD: Final = b"\0\1\0\0" + bytes(8)  # no dimensions, no offset
_LENGTH: Final = struct.Struct("<I")
_STAMP: Final = struct.Struct("<q")
_STAMP_AT: Final = len(_HEAD) + _LENGTH.size
_NAP_S: Final = 0.0001  # a publisher that is ahead; what is due then goes together: three of 30,000 a second
_PROBE_S: Final = 0.05  # until a probe arrives, the ways have to be found
_BEGIN_S: Final = 0.3  # of a run is not counted
_LINGER_S: Final = 1.0  # what is under way arrives
_LEAST_CPU_S: Final = 0.2e-6  # per message; of a thread that does less nothing is printed

Usage = dict[str, tuple[float, float]]
"""Seconds of a processor, and how often it waited, by the name of a thread."""
_NOTHING: Final = (0.0, 0.0)


# ── the ends ─────────────────────────────────────────────────────────────────────────────────────────────────────


def message(size: int, stamp_ns: int) -> bytes:
    """Return a message of ``size`` bytes as CDR; ``stamp_ns`` 0 marks a probe."""
    return b"".join((_HEAD, _LENGTH.pack(size), _STAMP.pack(stamp_ns), bytes(size - _STAMP.size)))


async def pace(args: argparse.Namespace, publish: Callable[[bytes], None], *, turns: bool) -> None:
    """Publish probes until told to begin, then messages evenly; print how many. With ``turns`` the loop turns."""
    probe = message(args.size, 0)
    while not select.select([sys.stdin], [], [], _PROBE_S)[0]:
        publish(probe)
        await asyncio.sleep(0)
    clock = time.time_ns
    began = clock()
    end, sent = began + int(1e9 * args.seconds), 0
    while (now := clock()) < end:
        if sent >= (now - began) * args.hz / 1e9:
            time.sleep(_NAP_S)  # noqa: ASYNC251 - finer than timers of the loop, which has nothing else to do
            continue
        publish(message(args.size, now))
        sent += 1
        if turns:
            await asyncio.sleep(0)
    print(json.dumps({"sent": sent, "seconds": (clock() - began) / 1e9}), flush=True)
    await asyncio.sleep(_LINGER_S)


class Notes:
    """The stamps of what arrived, and when; says so once a probe does."""

    def __init__(self) -> None:
        self._rows: list[tuple[int, int]] = []
        self._found = False

    def take(self, payload: bytes) -> None:
        """Note a message."""
        (stamp,) = _STAMP.unpack_from(payload, _STAMP_AT)
        if stamp:
            self._rows.append((time.time_ns(), stamp))
        elif not self._found:
            self._found = True
            print("found", flush=True)

    def tell(self) -> None:
        """Print the figures."""
        rows = np.array(self._rows or [(0, 0)])
        delays = (rows[:, 0] - rows[:, 1])[rows[:, 1] > rows[0, 1] + 1e9 * _BEGIN_S]
        p50, p99 = np.percentile(delays, [50, 99]) / 1e6 if len(delays) else (float("nan"), float("nan"))
        print(json.dumps({"n": len(self._rows), "p50": p50, "p99": p99}), flush=True)


def _ros_node(name: str) -> tuple[Any, Any, Any, Any]:
    import rclpy
    from rclpy.qos import QoSProfile
    from std_msgs.msg import UInt8MultiArray

    rclpy.init()
    return rclpy, rclpy.create_node(name), UInt8MultiArray, QoSProfile


async def source(args: argparse.Namespace) -> None:
    """Publish."""
    if args.ends == "rclpy":
        _, node, type, profile = _ros_node("small_source")
        await pace(args, node.create_publisher(type, TOPIC, profile(depth=args.depth)).publish, turns=False)
        os._exit(0)  # a node that is taken down properly takes a second or two
    graph = DdsGraph(args.domain, name="small_source", interface="lo")
    await graph.open()
    publisher = await graph.create_publisher(TOPIC, TYPE, QoS(depth=args.depth))
    await pace(args, lambda data: publisher.publish(Sample(data, TYPE, 1, bytes(16), SEQ_NONE)), turns=True)
    await graph.close()


async def sink(args: argparse.Namespace) -> None:
    """Take what comes until told to end."""
    notes = Notes()
    if args.ends == "rclpy":
        rclpy, node, type, profile = _ros_node("small_sink")

        def drain(payload: bytes) -> None:  # its executor takes one message at each turn, which would be the bottleneck
            notes.take(payload)
            while (taken := subscription.handle.take_message(type, True)) is not None:
                notes.take(taken[0])

        subscription = node.create_subscription(type, TOPIC, drain, profile(depth=args.depth), raw=True)

        def end() -> None:
            sys.stdin.readline()
            notes.tell()
            os._exit(0)

        threading.Thread(target=end, daemon=True).start()
        rclpy.spin(node)
        return

    def receive(batch: Sequence[Sample]) -> None:
        for sample in batch:
            notes.take(sample.payload)

    graph = DdsGraph(args.domain, name="small_sink", interface="lo")
    await graph.open()
    await graph.create_subscription(TOPIC, TYPE, QoS(depth=args.depth), receive)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    notes.tell()
    await graph.close()


# ── around them ──────────────────────────────────────────────────────────────────────────────────────────────────


class Subject(NamedTuple):
    """What joins the two domains: the commands of two gateways, or none for another checkout of ours."""

    name: str
    near: str = ""
    far: str = ""
    directory: str = ""
    bare: bool = False

    @property
    def far_domain(self) -> int:
        """Return the domain of the subscriber, which is the publisher's where nothing is between the two."""
        return DOMAIN_NEAR if self.bare else DOMAIN_FAR

    def start(self, directory: Path) -> Iterator[Process]:
        """Start the gateway that the publisher is at, and the other."""
        if self.bare:
            return
        if self.near:
            for command, domain in ((self.near, DOMAIN_NEAR), (self.far, DOMAIN_FAR)):
                yield ros_bridge(command, domain, PORT)
            return
        address = f"ws://127.0.0.1:{PORT}"
        route = {"address": address, "publish": [{"name": TOPIC, "type": TYPE}]}
        near = config(directory, "near", [route], None, f"dds:{DOMAIN_NEAR}?interface=lo")
        far = config(directory, "far", [], address, f"dds:{DOMAIN_FAR}?interface=lo")
        environment = {"PYTHONPATH": str(Path(self.directory) / "src")} if self.directory else {}
        for path in (near, far):
            yield Process(None, "-m", "ropeway", "run", path, "--quiet", **environment)


class Figures(NamedTuple):
    """What one run shows; what the gateways used is by thread and per message that was delivered."""

    offered_hz: float
    delivered_hz: float
    p50_ms: float
    p99_ms: float
    near: Usage
    far: Usage


def usage(pid: int) -> Usage:
    """Return what each thread of a process has used so far; those of Python have no names of their own."""
    used: Usage = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        name = "event loop" if int(task.name) == pid else (task / "comm").read_text().strip()
        lines = (task / "status").read_text().splitlines()
        waits = next(int(line.split()[1]) for line in lines if line.startswith("voluntary"))
        ran_ns = int((task / "schedstat").read_text().split()[0])
        cpu_s, count = used.get(name, _NOTHING)
        used[name] = (cpu_s + ran_ns / 1e9, count + waits)
    return used


def used_since(now: Usage, then: Usage, per: float) -> Usage:
    """Return what was used between two looks, divided by ``per``."""
    found = {}
    for name, (cpu_s, waits) in now.items():
        cpu_then_s, waits_then = then.get(name, _NOTHING)
        found[name] = ((cpu_s - cpu_then_s) / per, (waits - waits_then) / per)
    return found


def measure(subject: Subject, hz: float, args: argparse.Namespace) -> Figures:
    """Return what a run shows."""
    with tempfile.TemporaryDirectory() as directory, ExitStack() as stack:

        def start(role: str, domain: int) -> Process:
            options = {"domain": domain, "hz": hz, "seconds": args.seconds, "depth": args.depth, "size": args.size}
            arguments = [f"--{name}={value}" for name, value in options.items()]
            words = ("-m", "bench.small", role, f"--ends={args.ends}", *arguments)
            process = Process(None, *words, **ROS_ENVIRONMENT, ROS_DOMAIN_ID=str(domain))
            stack.callback(process.stop)
            return process

        gateways = []
        for process in subject.start(Path(directory)):
            stack.callback(process.stop)
            gateways.append(process)
        reader = start("sink", subject.far_domain)
        writer = start("source", DOMAIN_NEAR)
        if not reader.line():
            raise SystemExit(f"{subject.name}: nothing arrives")
        time.sleep(2)
        writer.tell()
        time.sleep(_BEGIN_S)
        before, began = [usage(p.pid) for p in gateways], time.monotonic()
        time.sleep(args.seconds - 2 * _BEGIN_S)
        after, span = [usage(p.pid) for p in gateways], time.monotonic() - began
        sent = json.loads(writer.line())
        time.sleep(_LINGER_S / 2)
        reader.tell()
        got = json.loads(reader.line())
    offered, delivered = (n / sent["seconds"] for n in (sent["sent"], got["n"]))
    per = span * max(delivered, 1)
    used = [used_since(now, then, per) for now, then in zip(after, before, strict=True)] or [{}, {}]
    return Figures(offered, delivered, got["p50"], got["p99"], *used)


def median(values: Iterable[float]) -> float:
    """Return the median."""
    return statistics.median(list(values))


def row(runs: Sequence[Figures]) -> list[float]:
    """Return the figures of a row: medians of all runs."""
    figures = [median(column) for column in zip(*(run[:4] for run in runs), strict=True)]
    used = [
        [[sum(thread[index] for thread in end.values()) for end in (run.near, run.far)] for run in runs]
        for index in (0, 1)
    ]
    cpu, waits = ([median(column) for column in zip(*ends, strict=True)] for ends in used)
    return [*figures, *(100 * figures[1] * seconds for seconds in cpu), *waits]


def thread_rows(runs: Sequence[Figures]) -> Iterator[list[Any]]:
    """Give what each thread used per message, medians of all runs."""
    for end, usages in (("near", [run.near for run in runs]), ("far", [run.far for run in runs])):
        for thread in sorted(set().union(*usages)):
            used = [each.get(thread, _NOTHING) for each in usages]
            cpu_s, waits = (median(column) for column in zip(*used, strict=True))
            if cpu_s > _LEAST_CPU_S:
                yield [end, thread, 1e6 * cpu_s, waits]


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("role", choices=["measure", "source", "sink"], nargs="?", default="measure")
    parser.add_argument("--rates", default="200,2000,10000,30000,60000")
    parser.add_argument("--hz", type=float, default=2000)
    parser.add_argument("--seconds", type=float, default=4)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--depth", type=int, default=10)
    parser.add_argument("--size", type=int, default=1000)
    parser.add_argument("--domain", type=int, default=0)
    parser.add_argument(
        "--ends", choices=["rclpy", "dds"], default="rclpy" if importlib.util.find_spec("rclpy") else "dds"
    )
    parser.add_argument("--before", default="", help="another checkout, measured in turns")
    parser.add_argument("--peer", nargs=3, action="append", default=[], metavar=("NAME", "NEAR", "FAR"))
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.role != "measure":
        with aio.Runner() as runner:
            runner.run({"source": source, "sink": sink}[args.role](args))
        return
    subjects = [Subject("none", bare=True), Subject("ropeway"), *(Subject(*words) for words in args.peer)]
    if args.before:
        subjects.insert(1, Subject("before", directory=args.before))
    rows: list[list[Any]] = []
    by_thread: list[list[Any]] = []
    for hz in map(float, args.rates.split(",")):
        runs: dict[str, list[Figures]] = {subject.name: [] for subject in subjects}
        for _ in range(args.runs):
            for subject in subjects:
                runs[subject.name].append(measure(subject, hz, args))
        for name, figures in runs.items():
            rows.append([f"{hz:g}", name, *row(figures)])
            by_thread.extend([f"{hz:g}", name, *found] for found in thread_rows(figures))
    heads = ["1 kB messages/s", "gateways", "offered/s", "delivered/s", "p50 ms", "p99 ms"]
    heads += ["near CPU %", "far CPU %", "waits near", "far"]
    title = f"small messages, ends by {args.ends}, depth {args.depth}"
    table(title, heads, rows, as_json=args.json)
    heads = ["1 kB messages/s", "gateways", "end", "thread", "CPU us per message", "waits"]
    table(f"{title}: by thread", heads, by_thread, as_json=args.json)


if __name__ == "__main__":
    main()
