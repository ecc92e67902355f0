"""Two links at once, one jittery and one slow: how late commands are by each alone, by the better, and by both.

``python -m bench.links``, as root; ROPEWAY_LINK names the program that joins two namespaces by a link (see
docs/performance.md). The robot reads /cmd_vel, 50 times a second, from a cloud that both links lead to, over ``ws://``
and over the overlay, while the links change.

``--cuts 20``: in their place the link in use is cut without a sign, again and again, while /odom goes the other way;
how long nothing comes then, and what is lost, each way.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import json
import os
import random
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
from ropeway.graph.base import Publisher, Sample
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.overlay.crypto.identity import write_private
from ropeway.networks.overlay.fleet import Fleet
from ropeway.qos import QoS
from ropeway.types import TypeRegistry
from ropeway.types.codec import MessageCodec

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
CUT_WEATHER: Final = ((10, 2), (40, 0))
BEFORE_CUT_S: Final = 1.0
CUT_S: Final = 1.0
WAYS: Final = {"first": ([0], None), "second": ([1], None), "best": ([0, 1], "best"), "both": ([0, 1], "duplicate")}


def settings(name: str, overlay: dict[str, Any] | None, **more: Any) -> dict[str, Any]:
    """Return the settings of a gateway beside a graph of memory."""
    made = {"name": name, "graphs": [f"memory:{name}"], "control": False, "listen": [], "insecure": True, **more}
    return made | ({"overlay": overlay} if overlay else {})


async def end(order: dict[str, Any]) -> None:
    """Be one end: publish a topic with the number and time of each message, and tell what came of another.

    For each line that is read a line is printed: what has come since, and how the links are.
    """
    codec = TypeRegistry().codec(TYPE)
    came: list[tuple[int, float, float]] = []  # number, how late, when

    def take(batch: Sequence[Sample]) -> None:
        now_s = time.monotonic()
        for sample in batch:
            number, sent_s = codec.decode(sample.payload)["data"].split()
            came.append((int(number), now_s - float(sent_s), now_s))

    async with Gateway(config.parse(order["config"])) as gateway:
        node = MemoryGraph(order["graph"], node="/node")
        await node.open()
        publishing = None
        if order["publish"]:
            publisher = await node.create_publisher(order["publish"], TYPE, QoS(depth=10))
            publishing = asyncio.create_task(publish(publisher, codec))
        if order["read"]:
            await node.create_subscription(order["read"], TYPE, QoS(depth=10), take)
        print("up", flush=True)
        while await asyncio.to_thread(sys.stdin.readline):
            print(json.dumps({"came": came, "links": links_of(gateway)}), flush=True)
            came.clear()
        if publishing is not None:
            publishing.cancel()


async def publish(publisher: Publisher, codec: MessageCodec) -> None:
    """Publish ``HZ`` messages a second that tell their number and when they were sent."""
    origin = os.urandom(16)
    began, number = time.monotonic(), 0
    while True:
        number += 1
        await asyncio.sleep(max(0.0, began + number / HZ - time.monotonic()))
        payload = codec.encode({"data": f"{number} {time.monotonic()}"})
        publisher.publish(Sample(payload, TYPE, time.time_ns(), origin, number))


def links_of(gateway: Gateway) -> dict[str, Any]:
    """Return how the links of a gateway's remote are, empty where it has one."""
    for remote in gateway.status()["remotes"]:
        found: dict[str, Any] = remote.get("links") or remote.get("overlay", {}).get("links") or {}
        return found
    return {}


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

    def cut(self, device: str, *, back: bool = False) -> None:
        """Have a link drop every packet, or carry them again."""
        with self._controls[self.devices.index(device)].open("w") as file:
            file.write("up\n" if back else "down\n")

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


@contextlib.contextmanager
def joined(
    here: Place, kind: str, way: str, fleet: dict[str, str], back: str = ""
) -> Iterator[tuple[Process, Process]]:
    """Start a cloud that publishes /cmd_vel and a robot that reads it; ``back`` is a topic that goes the other way."""
    used, links = WAYS[way]
    devices = [here.devices[index] for index in used]
    down = [{"name": "/cmd_vel", "type": TYPE, "depth": 10, "priority": "command"}]
    up = [{"name": back, "type": TYPE, "depth": 10}] if back else []
    if kind == "ws":
        cloud: dict[str, Any] = {"gateway": settings("cloud", None, listen=["ws://0.0.0.0:9090"]), "remotes": []}
        remote: dict[str, Any] = {"address": f"ws://{CLOUD}:9090", "interfaces": devices}
        remote |= {"subscribe": down, "publish": up} | ({"links": links} if links else {})
        robot: dict[str, Any] = {"gateway": settings("robot", None), "remotes": [remote]}
    else:
        near = {"identity": fleet["cloud"], "routers": ["tls/127.0.0.1:7447"], "listen": []}
        far: dict[str, Any] = {"identity": fleet["robot"], "routers": [f"tls/{CLOUD}:7447"], "listen": []}
        far |= {"interfaces": devices} | ({"links": links} if links else {})
        here_topics, there_topics = {"publish": down, "subscribe": up}, {"publish": up, "subscribe": down}
        cloud = {"gateway": settings("cloud", near), "remotes": [{"address": "overlay", **here_topics}]}
        robot = {"gateway": settings("robot", far), "remotes": [{"address": "overlay", **there_topics}]}
    here.weather(next(iter(WEATHER.values())))
    with contextlib.ExitStack() as stack:
        if kind == "overlay":
            words = ("--identity", fleet["router"], "--listen", "tls/0.0.0.0:7447", "--json")
            stack.enter_context(started(here.cloud, "-m", "ropeway", "router", *words))
        ends = []
        for namespace, what, publishes, reads in (
            (here.cloud, cloud, "/cmd_vel", back),
            (here.robot, robot, back, "/cmd_vel"),
        ):
            graph = what["gateway"]["name"]
            order = json.dumps({"config": what, "graph": graph, "publish": publishes, "read": reads})
            ends.append(stack.enter_context(started(namespace, "-m", "bench.links", "--order", order)))
        began = time.monotonic()
        for process in ends if back else ends[1:]:
            while not told(process)["came"]:
                if time.monotonic() - began > START_S:
                    raise SystemExit(f"{kind}, {way}: nothing arrives")
                time.sleep(0.2)
        time.sleep(SETTLED_S)
        yield ends[0], ends[1]


def told(process: Process) -> dict[str, Any]:
    """Return what an end tells: what has come since the last time, and how its links are."""
    process.tell()
    answer: dict[str, Any] = json.loads(process.line())
    return answer


def measured(here: Place, kind: str, way: str, fleet: dict[str, str], seconds: float) -> list[dict[str, float]]:
    """Return, for each weather, how late commands were and how many did not come."""
    found: list[dict[str, float]] = []
    with joined(here, kind, way, fleet) as (_, robot):
        for figures in WEATHER.values():
            here.weather(figures)
            time.sleep(SETTLED_S / 2)
            told(robot)
            time.sleep(seconds)
            came = told(robot)["came"]
            late = sorted(late_s for _, late_s, _ in came)
            missing = came[-1][0] - came[0][0] + 1 - len(came)
            found.append(
                {"p50": 1e3 * late[len(late) // 2], "p99": 1e3 * late[int(0.99 * len(late))], "missing": missing}
            )
    return found


def cuts(here: Place, kind: str, way: str, fleet: dict[str, str], count: int) -> list[list[Any]]:
    """Return, for each direction, how long nothing came after each of ``count`` cuts, and what was lost."""
    gaps: tuple[list[float], list[float]] = ([], [])
    lost = [0, 0]
    with joined(here, kind, way, fleet, "/odom") as ends:
        here.weather(CUT_WEATHER)
        for _ in range(count):
            device = ready(ends[1])
            for process in ends:
                told(process)
            time.sleep(BEFORE_CUT_S + random.random() / HZ)
            here.cut(device)
            time.sleep(CUT_S)
            for index, process in enumerate(ends):
                came = told(process)["came"]
                times = [at_s for _, _, at_s in came]
                gaps[index].append(1e3 * max(b - a for a, b in itertools.pairwise(times)))
                numbers = {number for number, _, _ in came}
                lost[index] += max(numbers) - min(numbers) + 1 - len(numbers)
            here.cut(device, back=True)
    return [
        [kind, way, direction, *(round(quantile(found, share), 1) for share in (0.0, 0.5, 0.9, 1.0)), gone]
        for direction, found, gone in zip(("to the cloud", "to the robot"), gaps, lost, strict=True)
    ]


def ready(robot: Process) -> str:
    """Wait until every link carries something and one has been in use for a while; return its name."""
    began, name = time.monotonic(), ""
    since = began
    while time.monotonic() - began < START_S:
        links = told(robot)["links"]
        well = all(link["up"] and not link["silent"] for link in links["members"].values())
        if not well or links["current"] != name:
            name, since = links["current"], time.monotonic()
        elif time.monotonic() - since > BEFORE_CUT_S:
            return name
        time.sleep(0.1)
    raise SystemExit("a link that was cut has not come back")


def quantile(found: Sequence[float], share: float) -> float:
    """Return the value that this share of them does not exceed."""
    return sorted(found)[min(int(share * len(found)), len(found) - 1)]


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=8.0, help="for each weather")
    parser.add_argument("--kind", choices=("ws", "overlay"), action="append", help="measure this network alone")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--way", choices=tuple(WAYS), action="append", help="use the links like this alone")
    parser.add_argument(
        "--cuts", type=int, default=0, help="cut the link in use so many times, in place of the weathers"
    )
    parser.add_argument("--order", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.order:
        asyncio.run(end(json.loads(given.order)))
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
                if given.cuts:
                    ways = given.way or ("best", "both")
                    rows = [row for way in ways for row in cuts(here, kind, way, fleet, given.cuts)]
                    heads = ["", "links", "direction", "shortest", "p50", "p90", "longest", "lost"]
                    table(
                        f"{kind}: longest time without a message in {given.cuts} cuts, in ms",
                        heads,
                        rows,
                        as_json=given.json,
                    )
                    continue
                ways = given.way or tuple(WAYS)
                found = {way: measured(here, kind, way, fleet, given.seconds) for way in ways}
                for figure in ("p50", "p99", "missing"):
                    rows = [[name, *(found[way][index][figure] for way in ways)] for index, name in enumerate(WEATHER)]
                    table(f"{kind}: {figure} of /cmd_vel", ["links, ms one way", *ways], rows, as_json=given.json)
        finally:
            here.end()


if __name__ == "__main__":
    main()
