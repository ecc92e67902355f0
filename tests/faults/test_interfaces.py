"""A member of the overlay with two network interfaces, one of which is cut."""

from __future__ import annotations

import asyncio
import os
import sys
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway.networks.overlay.crypto.identity import write_private
from tests.faults.conftest import ROOT, Machine, ip
from tests.networks.overlay.fleet import member
from tests.support.messages import STRING

pytestmark = [pytest.mark.netns, pytest.mark.slow, pytest.mark.timeout(300)]

HZ = 4.0  # what waits for two seconds is less than a publisher holds
ROUTER = "10.99.9.9"
"""Reached by both interfaces, as a router in the internet is by Wi-Fi and 5G."""


class Place:
    """A robot that two cables, ``wlan`` and ``wwan``, join with a router and a cloud."""

    def __init__(self, stack: AsyncExitStack, directory: Path) -> None:
        self.stack, self.directory = stack, directory
        self.robot, self.far = f"rwi{os.getpid()}a", f"rwi{os.getpid()}b"

    async def open(self) -> None:
        for namespace in (self.robot, self.far):
            ip(f"netns add {namespace}")
            self.stack.callback(ip, f"netns del {namespace}")
            ip(f"-n {namespace} link set lo up")
        ip(f"-n {self.far} addr add {ROUTER}/32 dev lo")
        for number, name in enumerate(("wlan", "wwan"), 1):
            ip(f"link add {name} netns {self.robot} type veth peer name {name} netns {self.far}")
            for namespace, end in ((self.robot, 1), (self.far, 2)):
                ip(f"-n {namespace} addr add 10.99.{number}.{end}/24 dev {name}")
                ip(f"-n {namespace} link set {name} up")
            ip(f"-n {self.robot} route add {ROUTER} via 10.99.{number}.2 metric {number}")
        await self._router()

    async def _router(self) -> None:
        bundle = self.bundle("router", role="router")
        program = (
            "import asyncio, pathlib, sys\n"
            "from ropeway.networks.overlay.crypto.identity import Identity\n"
            "from ropeway.networks.overlay.router import Router\n"
            "async def main():\n"
            "    async with Router(Identity.load(pathlib.Path(sys.argv[1])), listen=['tls/0.0.0.0:7447']):\n"
            "        print('up', flush=True)\n"
            "        await asyncio.Event().wait()\n"
            "asyncio.run(main())\n"
        )
        words = ["ip", "netns", "exec", self.far, sys.executable, "-c", program, bundle]
        process = await asyncio.create_subprocess_exec(*words, cwd=ROOT, stdout=asyncio.subprocess.PIPE)
        self.stack.push_async_callback(process.wait)
        self.stack.callback(process.kill)
        assert process.stdout is not None
        await process.stdout.readline()

    def bundle(self, name: str, **options: Any) -> str:
        path = self.directory / f"{name}.ropeway"
        write_private(path, member(name, **options).to_text())
        return str(path)

    def cut(self, name: str, *, back: bool = False) -> None:
        """Lose every packet of a cable without a sign, both ways: the next hop has an address that nobody has."""
        number = ("wlan", "wwan").index(name) + 1
        for namespace, other in ((self.robot, 2), (self.far, 1)):
            if back:
                ip(f"-n {namespace} neigh del 10.99.{number}.{other} dev {name}")
            else:
                neighbour = f"10.99.{number}.{other} lladdr 02:00:00:00:00:01 nud permanent dev {name}"
                ip(f"-n {namespace} neigh replace {neighbour}")

    async def machine(self, namespace: str, name: str, router: str, **order: Any) -> Machine:
        overlay = {"identity": self.bundle(name), "routers": [f"tls/{router}:7447"], "listen": []}
        overlay |= order.pop("overlay", {})
        made = Machine(namespace, {"name": name, "settings": {"overlay": overlay}, **order})
        await made.start()
        self.stack.push_async_callback(made.stop)
        return made


@pytest.fixture
async def place(stack: AsyncExitStack, tmp_path: Path) -> AsyncIterator[Place]:
    made = Place(stack, tmp_path)
    await made.open()
    yield made


async def test_the_interface_in_use_is_cut(place: Place) -> None:
    """Everything goes on by the other interface, in order and once.

    Nothing is lost, and nobody takes the member for gone, unless it was back before its router had let go of the old
    link: then links are made anew once nobody is heard of.
    """
    topics = {"publish": [{"name": "/up", "type": STRING}], "subscribe": [{"name": "/down", "type": STRING}]}
    back = {"publish": topics["subscribe"], "subscribe": topics["publish"]}
    cloud = await place.machine(
        place.far, "cloud", "127.0.0.1", remotes=[{"address": "overlay", **back}], publish={"/down": HZ}, read=["/up"]
    )
    robot = await place.machine(
        place.robot,
        "robot",
        ROUTER,
        overlay={"interfaces": ["wlan", "wwan"]},
        remotes=[{"address": "overlay", **topics}],
        publish={"/up": HZ},
        read=["/down"],
    )
    await cloud.until(lambda: len(cloud.heard("/up")) > 8)
    await robot.until(lambda: len(robot.heard("/down")) > 8)
    cut = time.monotonic()
    ip(f"-n {place.far} link set wlan down")
    await cloud.until(lambda: len(cloud.heard("/up", cut + 5)) > 8)
    await robot.until(lambda: len(robot.heard("/down", cut + 5)) > 8)
    too_soon = any("nobody is heard of" in line for line in (*robot.log, *cloud.log))
    for machine, topic in ((cloud, "/up"), (robot, "/down")):
        numbers = [number for _, number in machine.heard(topic)]
        assert numbers == sorted(set(numbers))
        assert too_soon or numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    for machine in (cloud, robot):
        assert not machine.status["remotes"][0]["overlay"]["refused"]
        told = [e["status"]["remotes"][0]["overlay"] for e in machine.events if "status" in e and e["t"] > cut]
        assert told
        assert too_soon or all(row["gateways"] for row in told)


def using(machine: Machine) -> str:
    """Return the link that a machine says it uses."""
    return str(machine.status["remotes"][0]["overlay"]["links"]["current"])


def overlay(machine: Machine) -> dict[str, Any]:
    """Return what a machine tells of the overlay."""
    found: dict[str, Any] = machine.status["remotes"][0]["overlay"]
    return found


async def joined(place: Place, links: str) -> tuple[Machine, Machine]:
    """Return a cloud, and a robot that uses both of its interfaces at once; each hears the other."""
    topics = {"publish": [{"name": "/up", "type": STRING}], "subscribe": [{"name": "/down", "type": STRING}]}
    back = {"publish": topics["subscribe"], "subscribe": topics["publish"]}
    cloud = await place.machine(
        place.far, "cloud", "127.0.0.1", remotes=[{"address": "overlay", **back}], publish={"/down": 50}, read=["/up"]
    )
    robot = await place.machine(
        place.robot,
        "robot",
        ROUTER,
        overlay={"interfaces": ["wlan", "wwan"], "links": links},
        remotes=[{"address": "overlay", **topics}],
        publish={"/up": 50},
        read=["/down"],
    )
    for machine, topic in ((cloud, "/up"), (robot, "/down")):
        await machine.until(lambda: len(machine.heard(topic)) > 100)  # noqa: B023
    members = overlay(robot)["links"]["members"]
    await robot.until(lambda: all(link["rtt_ms"] for link in overlay(robot)["links"]["members"].values()))
    assert set(members) == {"wlan", "wwan"}
    return robot, cloud


@pytest.mark.parametrize("links", ["best", "duplicate"])
async def test_two_links_of_which_one_is_cut(place: Place, links: str) -> None:
    """Everything goes on by the other link, in order and once; nobody is taken for gone, and no copy for an attack.

    With duplicates nothing is lost.
    """
    robot, cloud = await joined(place, links)
    began = time.monotonic()
    for _ in range(2):
        name, cut = using(robot), time.monotonic()
        place.cut(name)
        for machine, topic in ((cloud, "/up"), (robot, "/down")):
            await machine.until(lambda: len(machine.heard(topic, cut + 1)) > 50)  # noqa: B023
        await robot.until(lambda: using(robot) != name)  # noqa: B023
        place.cut(name, back=True)
        await robot.until(lambda: all(link["up"] for link in overlay(robot)["links"]["members"].values()))
        await robot.until(lambda: not any(link["silent"] for link in overlay(robot)["links"]["members"].values()))
    for machine, topic in ((cloud, "/up"), (robot, "/down")):
        numbers = [number for _, number in machine.heard(topic)]
        assert numbers == sorted(set(numbers))
        if links == "duplicate":
            assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
            assert overlay(machine)["copies"]
    for machine in (cloud, robot):
        assert not overlay(machine)["refused"]
        told = [e["status"]["remotes"][0]["overlay"] for e in machine.events if "status" in e and e["t"] > began]
        assert all(row["gateways"] for row in told)
