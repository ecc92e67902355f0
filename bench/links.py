"""Two links at once, one jittery and one slow: how late commands are by each alone, by the better, and by both.

``python -m bench.links``, as root; ROPEWAY_LINK names the program that joins two namespaces by a link (see
docs/performance.md). The robot reads /cmd_vel, 50 times a second, from a cloud that both links lead to, over ``ws://``
and over the overlay, while the links change.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from bench.netns import Process
from bench.report import table
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import Sample
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.overlay.crypto.identity import write_private
from ropeway.networks.overlay.fleet import Fleet
from ropeway.qos import QoS
from ropeway.types import TypeRegistry

CLOUD: Final = "10.98.9.9"
TYPE: Final = "std_msgs/msg/String"
HZ: Final = 50.0
SETTLED_S: Final = 4.0  # after the start, and after each change of the links: half as long
START_S: Final = 60.0
WEATHER: Final = {  # of the two links: delay and jitter one way, in milliseconds
    "10 ± 2, 40": ((10, 2), (40, 0)),
    "60 ± 50, 40": ((60, 50), (40, 0)),
    "10, 40 ± 30": ((10, 0), (40, 30)),
}
WAYS: Final = {"first": ([0], None), "second": ([1], None), "best": ([0, 1], "best"), "both": ([0, 1], "duplicate")}


def settings(name: str, overlay: dict[str, Any] | None, **more: Any) -> dict[str, Any]:
    """Return the settings of a gateway beside a graph of memory."""
    made = {"name": name, "graphs": [f"memory:{name}"], "control": False, "listen": [], "insecure": True, **more}
    return made | ({"overlay": overlay} if overlay else {})


async def talk(order: dict[str, Any]) -> None:
    """Be the cloud: publish commands that tell when they were sent."""
    codec = TypeRegistry().codec(TYPE)
    async with Gateway(config.parse(order["config"])):
        node = MemoryGraph("cloud", node="/driver")
        await node.open()
        publisher = await node.create_publisher("/cmd_vel", TYPE, QoS(depth=10))
        print("up", flush=True)
        began, number = time.monotonic(), 0
        while True:
            number += 1
            await asyncio.sleep(max(0.0, began + number / HZ - time.monotonic()))
            payload = codec.encode({"data": f"{number} {time.monotonic()}"})
            publisher.publish(Sample(payload, TYPE, time.time_ns(), b"cloud".ljust(16), number))


async def read(order: dict[str, Any]) -> None:
    """Be the robot: print, for each line that is read, which commands have come since and how late."""
    codec = TypeRegistry().codec(TYPE)
    came: list[tuple[int, float]] = []

    def take(batch: Sequence[Sample]) -> None:
        for sample in batch:
            number, sent_s = codec.decode(sample.payload)["data"].split()
            came.append((int(number), time.monotonic() - float(sent_s)))

    async with Gateway(config.parse(order["config"])):
        node = MemoryGraph("robot", node="/base")
        await node.open()
        await node.create_subscription("/cmd_vel", TYPE, QoS(depth=10), take)
        print("up", flush=True)
        while await asyncio.to_thread(sys.stdin.readline):
            print(json.dumps(came), flush=True)
            came.clear()


class Place:
    """A robot's and a cloud's namespace, joined by two links; ``devices`` are the robot's."""

    def __init__(self, directory: Path) -> None:
        self.robot, self.cloud = f"rwl{os.getpid()}r", f"rwl{os.getpid()}c"
        self._controls = [directory / f"{number}.ctl" for number in (1, 2)]
        self._links: list[subprocess.Popen[bytes]] = []
        for number, control in enumerate(self._controls, 1):
            words = ["--a", self.robot, f"10.98.{number}.1", "--b", self.cloud, f"10.98.{number}.2"]
            words += ["--control", str(control)]
            link = subprocess.Popen([sys.executable, os.environ["ROPEWAY_LINK"], *words], stdout=subprocess.PIPE)
            assert link.stdout is not None
            link.stdout.readline()
            self._links.append(link)
        ip(f"-n {self.cloud} addr add {CLOUD}/32 dev lo")
        self.devices = [self._device(f"10.98.{number}.1") for number in (1, 2)]
        for number, device in enumerate(self.devices, 1):
            ip(f"-n {self.robot} route add {CLOUD} via 10.98.{number}.2 dev {device} metric {number}")

    def _device(self, address: str) -> str:
        rows = json.loads(ip(f"-n {self.robot} -j addr"))
        return next(str(row["ifname"]) for row in rows if any(a["local"] == address for a in row["addr_info"]))

    def weather(self, figures: Sequence[tuple[float, float]]) -> None:
        """Change the links."""
        for control, (delay_ms, jitter_ms) in zip(self._controls, figures, strict=True):
            with control.open("w") as file:
                file.write(f"delay_ms={delay_ms} jitter_ms={jitter_ms}\n")

    def end(self) -> None:
        """End the links and the namespaces."""
        for link in self._links:
            link.terminate()
            link.wait()
        for namespace in (self.robot, self.cloud):
            subprocess.run(["ip", "netns", "del", namespace], check=False, capture_output=True)


def ip(command: str) -> str:
    """Run ``ip``, and return what it prints."""
    return subprocess.run(["ip", *command.split()], check=True, capture_output=True, text=True).stdout


@contextlib.contextmanager
def started(namespace: str, *words: str) -> Iterator[Process]:
    """Run a part of this bench, or of ropeway, in a namespace."""
    process = Process(namespace, *words)
    try:
        process.line()
        yield process
    finally:
        process.stop()


def measured(here: Place, kind: str, way: str, fleet: dict[str, str], seconds: float) -> list[dict[str, float]]:
    """Return, for each weather, how late commands were and how many did not come."""
    used, links = WAYS[way]
    devices = [here.devices[index] for index in used]
    topic = [{"name": "/cmd_vel", "type": TYPE, "depth": 10, "priority": "command"}]
    if kind == "ws":
        cloud: dict[str, Any] = {"gateway": settings("cloud", None, listen=["ws://0.0.0.0:9090"]), "remotes": []}
        remote: dict[str, Any] = {"address": f"ws://{CLOUD}:9090", "interfaces": devices, "subscribe": topic}
        remote |= {"links": links} if links else {}
        robot: dict[str, Any] = {"gateway": settings("robot", None), "remotes": [remote]}
    else:
        near = {"identity": fleet["cloud"], "routers": ["tls/127.0.0.1:7447"], "listen": []}
        far: dict[str, Any] = {
            "identity": fleet["robot"],
            "routers": [f"tls/{CLOUD}:7447"],
            "listen": [],
            "interfaces": devices,
        }
        if links:
            far["links"] = links
        cloud = {"gateway": settings("cloud", near), "remotes": [{"address": "overlay", "publish": topic}]}
        robot = {"gateway": settings("robot", far), "remotes": [{"address": "overlay", "subscribe": topic}]}
    found: list[dict[str, float]] = []
    here.weather(next(iter(WEATHER.values())))
    with contextlib.ExitStack() as stack:
        if kind == "overlay":
            router = (
                "-m",
                "ropeway",
                "router",
                "--identity",
                fleet["router"],
                "--listen",
                "tls/0.0.0.0:7447",
                "--json",
            )
            stack.enter_context(started(here.cloud, *router))
        for namespace, part, what in ((here.cloud, "talk", cloud), (here.robot, "read", robot)):
            process = stack.enter_context(
                started(namespace, "-m", "bench.links", "--part", part, "--order", json.dumps({"config": what}))
            )
        began = time.monotonic()
        while not _come(process):
            if time.monotonic() - began > START_S:
                raise SystemExit(f"{kind}, {way}: nothing arrives")
            time.sleep(0.2)
        time.sleep(SETTLED_S)
        for figures in WEATHER.values():
            here.weather(figures)
            time.sleep(SETTLED_S / 2)
            _come(process)
            time.sleep(seconds)
            came = _come(process)
            late = sorted(late_s for _, late_s in came)
            missing = came[-1][0] - came[0][0] + 1 - len(came)
            found.append({"p99": 1e3 * late[int(0.99 * len(late))], "missing": missing})
    return found


def _come(process: Process) -> list[tuple[int, float]]:
    process.tell()
    came: list[tuple[int, float]] = json.loads(process.line())
    return came


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=8.0, help="for each weather")
    parser.add_argument("--kind", choices=("ws", "overlay"), action="append", help="measure this network alone")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--part", choices=("talk", "read"), help=argparse.SUPPRESS)
    parser.add_argument("--order", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.part:
        asyncio.run({"talk": talk, "read": read}[given.part](json.loads(given.order)))
        return
    if not os.environ.get("ROPEWAY_LINK"):
        print("skipped; name a program that joins namespaces in ROPEWAY_LINK")
        return
    with tempfile.TemporaryDirectory() as directory:
        made = Fleet.create("bench", Path(directory) / "fleet")
        fleet = {name: str(Path(directory) / f"{name}.ropeway") for name in ("cloud", "robot", "router")}
        for name, path in fleet.items():
            role = "router" if name == "router" else "member"
            write_private(Path(path), made.issue(name, role=role).to_text())
        here = Place(Path(directory))
        try:
            for kind in given.kind or ("ws", "overlay"):
                found = {way: measured(here, kind, way, fleet, given.seconds) for way in WAYS}
                rows = [
                    [name, *(found[way][index]["p99"] for way in WAYS), *(found[way][index]["missing"] for way in WAYS)]
                    for index, name in enumerate(WEATHER)
                ]
                heads = ["links, ms one way", *WAYS, *(f"missing, {way}" for way in WAYS)]
                table(f"{kind}: P99 of /cmd_vel in ms", heads, rows, as_json=given.json)
        finally:
            here.end()


if __name__ == "__main__":
    main()
