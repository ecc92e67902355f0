"""What it costs to watch a gateway: its status and metrics, an explanation over a slow link, and a start with it."""

from __future__ import annotations

import contextlib
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import psutil

from bench.netns import delayed
from ropeway.control.client import ControlClient
from ropeway.errors import ControlError

__all__ = ["ask_ms", "explain_s", "start_up", "watched_share"]

_STRING: Final = "std_msgs/msg/String"
_PORT: Final = 19_391
_PATHS: Final = ("/v1/status", "/metrics")


@contextlib.contextmanager
def running(directory: Path, name: str, *, namespace: str = "", **document: Any) -> Iterator[psutil.Process]:
    """Run a gateway in a process of its own, with its control socket in ``directory``."""
    file = directory / f"{name}.json"
    settings = {"name": name, "graphs": [f"memory:{name}"], "listen": [], **document.pop("gateway", {})}
    file.write_text(json.dumps({"gateway": settings, **document}))
    prefix = ["ip", "netns", "exec", namespace] if namespace else []
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    environment |= {"XDG_RUNTIME_DIR": str(directory), "XDG_STATE_HOME": str(directory)}
    command = [*prefix, sys.executable, "-m", "ropeway", "run", str(file), "--log-level", "info"]
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        for line in process.stderr:
            if f"{name} is on" in line:
                break
        else:
            raise RuntimeError(f"{name} did not start")
        yield psutil.Process(process.pid)
    finally:
        process.terminate()
        process.communicate()


@contextlib.contextmanager
def pair(directory: Path, routes: int, ends: tuple[str, str, str] = ("", "", "127.0.0.1")) -> Iterator[psutil.Process]:
    """Run a gateway with so many routes to another one; yield its process once they are linked."""
    url = f"ws://{ends[2]}:{_PORT}"
    items = [{"name": f"/t{number}", "type": _STRING} for number in range(routes)]
    listen = {"listen": [f"ws://{ends[2]}:{_PORT}"], "insecure": True}
    with (
        running(directory, "cloud", namespace=ends[1], gateway=listen),
        running(directory, "robot", namespace=ends[0], remotes=[{"address": url, "publish": items}]) as robot,
    ):
        while _link_state(directory) != "connected":
            time.sleep(0.1)
        yield robot


def _link_state(directory: Path) -> str:
    with contextlib.suppress(ControlError), ControlClient.find(str(directory / "ropeway/robot.sock")) as client:
        return str(client.get("/v1/status")["remotes"][0]["state"])
    return ""


def ask_ms(directory: Path, routes: int, runs: int) -> list[tuple[str, float, float]]:
    """Milliseconds until the state of so many routes, and their metrics, have been answered: median, slowest."""
    found = []
    with pair(directory, routes), ControlClient.find(str(directory / "ropeway/robot.sock")) as client:
        for path in _PATHS:
            client.get(path)
            times = [_timed(client, path) for _ in range(runs)]
            found.append((path, statistics.median(times), max(times)))
    return found


def _timed(client: ControlClient, path: str, **query: Any) -> float:
    began = time.perf_counter()
    client.get(path, **query)
    return 1e3 * (time.perf_counter() - began)


def watched_share(directory: Path, routes: int, seconds: int) -> list[tuple[str, float]]:
    """Per cent of a core that a gateway takes more when it is asked once a second."""
    found = []
    with pair(directory, routes) as robot, ControlClient.find(str(directory / "ropeway/robot.sock")) as client:
        time.sleep(5)  # until the first look at all routes is over
        idle = _share(robot, seconds, lambda: None)
        for path in _PATHS:
            client.get(path)
            share = _share(robot, seconds, lambda path=path: client.get(path))  # type: ignore[misc]
            found.append((path, share - idle))
    return found


def _share(process: psutil.Process, seconds: int, each_second: Any) -> float:
    before, began = process.cpu_times(), time.monotonic()
    for number in range(seconds):
        each_second()
        time.sleep(max(began + number + 1 - time.monotonic(), 0))
    after = process.cpu_times()
    return 100 * (after.user + after.system - before.user - before.system) / (time.monotonic() - began)


def explain_s(directory: Path, runs: int) -> float | None:
    """Seconds until a route is explained on both ends, the peer at 35 ms; ``None`` without a program for the link."""
    with delayed(f"rwe{os.getpid() % 10_000}", "10.77.35", delay_ms=35) as ends:
        if ends is None:
            return None
        with pair(directory, 10, ends), ControlClient.find(str(directory / "ropeway/robot.sock")) as client:
            return max(_timed(client, "/v1/explain", name="/t3") for _ in range(runs)) / 1e3


def start_up(directory: Path, runs: int) -> list[tuple[str, float, float]]:
    """Seconds until a gateway is up, and megabytes that it then has, with the control plane and without: medians."""
    found = []
    for name, control in (("with", True), ("without", False)):
        times, memory = [], []
        for _ in range(runs):
            began = time.perf_counter()
            with running(directory, "started", gateway={"control": control}) as process:
                times.append(time.perf_counter() - began)
                if control:
                    with ControlClient.find(str(directory / "ropeway/started.sock")) as client:
                        client.get("/v1/routes")
                time.sleep(1)
                memory.append(process.memory_info().rss / 1e6)
        found.append((name, statistics.median(times), statistics.median(memory)))
    return found
