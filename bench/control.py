"""The control plane: a route added to 100 that run, plans of 1,000, a restart with a journal of 10,000 changes.

And what it costs to be there and to be watched (``bench/control_plane.py``).
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import uvloop

from bench.control_plane import ask_ms, explain_s, start_up, watched_share
from bench.report import table
from ropeway.control.caller import Caller
from ropeway.control.client import ControlClient
from ropeway.control.manager import Manager
from ropeway.control.record import ChangeRecord
from ropeway.errors import ControlError
from ropeway.gateway.config.config import Config, load, parse
from ropeway.gateway.gateway import Gateway
from ropeway.gateway.journal import Journal, JournalEntry
from ropeway.gateway.plan import make_plan
from ropeway.gateway.state_place import default_journal
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import QoS

STRING = "std_msgs/msg/String"
PAYLOAD = b"\0\1\0\0\6\0\0\0hello\0"
HZ = 10.0  # of each of the topics that run
RUNNING = 100
ROUTES = 1_000
CHANGES = 10_000
BEFORE_S = 3.0


def items(count: int) -> list[dict[str, Any]]:
    """Return so many topics."""
    return [{"name": f"/t{i}", "type": STRING} for i in range(count)]


def made(name: str, remotes: list[dict[str, Any]], **more: Any) -> Config:
    """Return a configuration on a network in memory."""
    gateway = {"name": name, "graphs": [f"memory:{name}"], "listen": [], **more}
    return parse({"gateway": gateway, "remotes": remotes})


class Traffic:
    """Topics that run at a steady rate over the gateways, and their delays."""

    def __init__(self) -> None:
        self.sent: dict[str, int] = {}
        self.heard: dict[str, int] = {}
        self.delays: list[float] = []

    def hear(self, topic: str) -> Any:
        def heard(batch: Any) -> None:
            now = time.time_ns()
            self.heard[topic] = self.heard.get(topic, 0) + len(batch)
            self.delays += [(now - message.sent_ns) / 1e6 for message in batch if message.sent_ns]

        return heard


async def apply_once(directory: Path) -> tuple[float, int, float, float]:
    """Milliseconds to the first message of a new route, messages lost on the others, and their delays (p99)."""
    async with Gateway(made("cloud", [], listen=["ws://127.0.0.1:0"])) as cloud:
        url = f"ws://127.0.0.1:{cloud.servers[0].listeners[0].port}"
        before = made("robot", [{"address": url, "publish": items(RUNNING)}])
        async with Gateway(before) as robot:
            manager = Manager(robot, ChangeRecord(Journal(directory / f"{time.monotonic_ns()}.journal")))
            here, there = MemoryGraph("robot", node="/here"), MemoryGraph("cloud", node="/there")
            await here.open()
            await there.open()
            traffic, qos = Traffic(), QoS(depth=1000)
            publishers = []
            for i in range(RUNNING):
                await there.create_subscription(f"/t{i}", STRING, qos, traffic.hear(f"/t{i}"))
                publishers.append(await here.create_publisher(f"/t{i}", STRING, qos))
            while any(not publisher.subscribers for publisher in publishers):
                await asyncio.sleep(0.01)

            async def talk(publisher: Any, place: int) -> None:
                await asyncio.sleep(place / RUNNING / HZ)  # not all at once: they would wait for each other
                while True:
                    now = time.time_ns()
                    publisher.publish(Sample(PAYLOAD, STRING, now, bytes(16), SEQ_NONE, sent_ns=now))
                    traffic.sent[publisher.topic] = traffic.sent.get(publisher.topic, 0) + 1
                    await asyncio.sleep(1 / HZ)

            talking = [asyncio.create_task(talk(publisher, i)) for i, publisher in enumerate(publishers)]
            await asyncio.sleep(BEFORE_S)
            quiet, traffic.delays = _p99(traffic.delays), []
            first = asyncio.Event()
            await there.create_subscription("/new", STRING, qos, lambda _: first.set())
            publisher = await here.create_publisher("/new", STRING, qos)
            new = [{"address": url, "publish": [*items(RUNNING), {"name": "/new", "type": STRING}]}]
            began = time.monotonic()
            applying = asyncio.create_task(manager.apply(made("robot", new), Caller("bench", "here")))
            while not first.is_set():
                publisher.publish(Sample(PAYLOAD, STRING, time.time_ns(), bytes(16), SEQ_NONE))
                await asyncio.sleep(0.002)
            first_ms = 1e3 * (time.monotonic() - began)
            await applying
            await asyncio.sleep(2 / HZ)  # until what was held up meanwhile has come
            busy = _p99(traffic.delays)
            for task in talking:
                task.cancel()
            await asyncio.sleep(0.5)
            lost = sum(traffic.sent[topic] - traffic.heard.get(topic, 0) for topic in traffic.sent)
            await manager.close()
            await here.close()
            await there.close()
    return first_ms, lost, quiet, busy


def _p99(values: list[float]) -> float:
    return sorted(values)[int(0.99 * (len(values) - 1))]


def plan_once() -> float:
    """Milliseconds to plan a change of one route among many."""
    old = made("robot", [{"address": "ws://a:1", "publish": items(ROUTES)}])
    new = made("robot", [{"address": "ws://a:1", "publish": items(ROUTES + 1)[1:]}])
    began = time.monotonic()
    plan = make_plan(old, new)
    assert len(plan.steps) == 2
    return 1e3 * (time.monotonic() - began)


def restart_once(directory: Path) -> float:
    """Seconds from starting after kill -9 until the routes are back, with a long journal."""
    os.environ |= {"XDG_STATE_HOME": str(directory), "XDG_RUNTIME_DIR": str(directory)}
    file = directory / "robot.json"
    file.write_text(json.dumps(made("restarted", [{"address": "ws://127.0.0.1:9", "publish": items(10)}]).to_json()))
    config = load(file)
    command = [sys.executable, "-m", "ropeway", "run", str(file), "--quiet"]
    process = subprocess.Popen(command)
    _wait(10)
    process.send_signal(signal.SIGKILL)
    process.wait()
    _fill(default_journal("restarted", str(file)), config)
    with ControlledRun(command):
        client_sees = _wait(10)
        with ControlClient.find("restarted") as client:
            client.post("/v1/routes", {"remote": "0", "operation": "publish", "item": {"name": "/x", "type": STRING}})
    began = time.monotonic()
    with ControlledRun(command):
        _wait(11)
        seconds = time.monotonic() - began
    assert client_sees
    return seconds


class ControlledRun:
    """A gateway in a process of its own, which ends with kill -9."""

    def __init__(self, command: list[str]) -> None:
        self._process = subprocess.Popen(command)

    def __enter__(self) -> None:
        """Do nothing: it runs."""

    def __exit__(self, *_: object) -> None:
        self._process.send_signal(signal.SIGKILL)
        self._process.wait()


def _fill(path: Path, config: Config) -> None:
    journal = Journal(path)
    last = journal.last_up()
    assert last is not None
    with journal._db:
        for number in range(CHANGES):
            row = (time.time(), "bench", "here", "apply", "", last.file_digest, last.etag, "up", str(number), "[]")
            journal._db.execute(
                "INSERT INTO entries (time_s, who, place, action, source, file_digest, etag, state, note, plan)"
                " VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                row,
            )
    assert isinstance(last, JournalEntry)
    assert config.etag == last.etag
    journal.close()


def _wait(routes: int) -> bool:
    while True:
        try:
            with ControlClient.find("restarted") as client:
                if len(client.get("/v1/routes")) == routes:
                    return True
        except ControlError:
            time.sleep(0.01)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--seconds", type=int, default=20, help="of being asked once a second")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows: list[list[Any]] = []
    with tempfile.TemporaryDirectory(prefix="rw-") as text:
        directory = Path(text)
        for _ in range(args.runs):
            first_ms, lost, quiet, busy = uvloop.run(apply_once(directory))
            rows.append(["apply to 100 routes", first_ms, lost, busy - quiet])
        plans = [plan_once() for _ in range(args.runs)]
        restarts = [restart_once(directory) for _ in range(args.runs)]
        asked = ask_ms(directory, ROUTES, 10 * args.runs)
        shares = watched_share(directory, ROUTES, args.seconds)
        explained = explain_s(directory, args.runs)
        started = start_up(directory, 2 * args.runs)
    table("apply", ["", "first message ms (< 300)", "lost", "delay added, p99 ms (<= 5)"], rows, as_json=args.json)
    other = [["plan, 1,000 routes: ms (< 200)", statistics.median(plans), max(plans)]]
    other.append(["restart, 10,000 changes: s (< 1.5)", statistics.median(restarts), max(restarts)])
    table("plan and restart", ["", "median", "slowest"], other, as_json=args.json)
    heads = ["asked of 1,000 routes", "ms, median (< 50)", "ms, slowest", "% of a core, once a second (< 1)"]
    watched = [[*row, share] for row, (_, share) in zip(asked, shares, strict=True)]
    table("watched", heads, watched, as_json=args.json)
    table("explain, the peer at 35 ms", ["s, slowest (< 1)"], [[explained]], as_json=args.json)
    heads = ["control plane", "s until it is up (< 0.7)", "memory MB (+15 at most)"]
    table("start", heads, [list(row) for row in started], as_json=args.json)


if __name__ == "__main__":
    main()
