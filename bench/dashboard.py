"""The dashboard: what it costs a gateway that three of them watch, and how long the first picture takes."""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
from tests.networks.rosbridge.server.browser import CHROMIUM

from bench.report import table
from ropeway.control.client import ControlTarget
from ropeway.dashboard.watch import GatewayWatch

STRING = "std_msgs/msg/String"
DASHBOARDS = 3
ROUTES = (20, 1_000)


@contextmanager
def process(*command: str) -> Iterator[subprocess.Popen[str]]:
    """A process of ropeway for the length of the block."""
    with subprocess.Popen([sys.executable, "-m", "ropeway", *command], stdout=subprocess.PIPE, text=True) as started:
        try:
            yield started
        finally:
            started.terminate()


@contextmanager
def gateway(directory: Path, routes: int) -> Iterator[tuple[psutil.Process, ControlTarget]]:
    """A gateway with so many routes to nowhere."""
    items = [{"name": f"/topic{number}", "type": STRING} for number in range(routes)]
    remote = {"address": "ws://127.0.0.1:9", "publish": items}
    settings = {"name": "bench", "graphs": ["memory:bench"], "listen": [], "control": {"remember": False}}
    file = directory / "bench.json"
    file.write_text(json.dumps({"gateway": settings, "remotes": [remote]}))
    socket = directory / "ropeway" / "bench.sock"
    with process("run", str(file), "--quiet") as started:
        while not socket.exists():
            time.sleep(0.1)
        time.sleep(3)  # it has only begun
        yield psutil.Process(started.pid), ControlTarget("bench", socket=socket)


async def share(watched: psutil.Process, target: ControlTarget, dashboards: int, seconds: float) -> float:
    """Return the part of a core, in per cent, that a gateway takes with so many dashboards that look at it."""
    watches = [GatewayWatch("bench", target) for _ in range(dashboards)]
    await asyncio.sleep(2)
    before, began = sum(watched.cpu_times()[:2]), time.monotonic()
    until = began + seconds
    while time.monotonic() < until:
        for watch in watches:
            watch.look()
        await asyncio.sleep(0.5)
    took = sum(watched.cpu_times()[:2]) - before
    for watch in watches:
        assert watch.status is not None, watch.error
        await watch.close()
    return 100 * took / (time.monotonic() - began)


async def first_pictures(url: str, times: int) -> list[float]:
    """Return the seconds from the address to the drawn map: of a browser that knows nothing, then of one that does."""
    from playwright.async_api import async_playwright

    async with async_playwright() as driver:
        browser = await driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        found = []
        for _ in range(times):
            page = await (await browser.new_context()).new_page()
            for _ in range(2):
                began = time.monotonic()
                await page.goto(url)
                await page.locator("svg[role=img]:visible text").first.wait_for()
                found.append(time.monotonic() - began)
        return found


def main() -> None:
    """Measure, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    rows: list[list[Any]] = []
    pictures: list[float] = []
    with tempfile.TemporaryDirectory() as name:
        os.environ["XDG_RUNTIME_DIR"] = name
        for routes in ROUTES:
            with gateway(Path(name), routes) as (watched, target):
                alone = asyncio.run(share(watched, target, 0, given.seconds))
                with_them = asyncio.run(share(watched, target, DASHBOARDS, given.seconds))
                rows.append([routes, alone, with_them, with_them - alone])
                if routes == ROUTES[0] and CHROMIUM is not None:
                    with process("dashboard", "--port", "0") as dashboard:
                        assert dashboard.stdout is not None
                        pictures = asyncio.run(first_pictures(dashboard.stdout.readline().strip(), 5))
    heads = ["routes", "alone %", f"{DASHBOARDS} dashboards %", "they cost %"]
    table("A gateway that is watched (share of a core)", heads, rows, as_json=given.json)
    if pictures:
        row = [statistics.median(pictures[::2]), statistics.median(pictures[1::2])]
        table("The first picture, s", ["new browser", "again"], [row], as_json=given.json)


if __name__ == "__main__":
    main()
