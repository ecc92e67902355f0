"""Links that are cut, peers that die, readers that stall, clocks that are wrong: two machines and what is between."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from tests.contract.test_topics import STRING
from tests.faults.conftest import Machine, Pair

pytestmark = [pytest.mark.netns, pytest.mark.timeout(90)]

MakePair = Callable[[], Awaitable[Pair]]
NOTICED_S = 5.0
BACK_S = 2.0
HZ = 20.0


def item(name: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "type": STRING, **more}


async def two_gateways(pair: Pair, **robot: Any) -> tuple[Machine, Machine]:
    """The robot dials in to the cloud; a topic goes up, another comes down."""
    cloud = await pair.machine(
        "b", name="cloud", listen=[f"ws://{pair.address_b}:9090"], publish={"/down": HZ}, read=["/up"]
    )
    remote = {"address": f"ws://{pair.address_b}:9090", "publish": [item("/up")], "subscribe": [item("/down")]}
    machine = await pair.machine("a", name="robot", remotes=[remote], publish={"/up": HZ}, read=["/down"], **robot)
    await flows(machine, cloud, time.monotonic(), 10)
    return machine, cloud


async def flows(robot: Machine, cloud: Machine, since: float, timeout_s: float) -> float:
    """Wait until something came both ways; gives how long that took."""
    await robot.until(lambda: robot.heard("/down", since), timeout_s)
    await cloud.until(lambda: cloud.heard("/up", since), timeout_s)
    return max(robot.heard("/down", since)[0][0], cloud.heard("/up", since)[0][0]) - since


def once_and_in_order(machine: Machine, topic: str) -> None:
    numbers = [n for _, n in machine.heard(topic)]
    assert numbers == sorted(set(numbers))


@pytest.mark.parametrize("seconds", [0.7, 2.2, 3.1, 4.5, 20.0])
async def test_cut_link(pair: MakePair, seconds: float) -> None:
    """A cut is noticed within 5 s on both sides, and data flows both ways within 2 s of the end of any cut."""

    async def cut(silently: bool) -> None:
        net = await pair()
        robot, cloud = await two_gateways(net)
        act = net.swallow if silently else net.pull
        act()
        began = time.monotonic()
        await asyncio.sleep(seconds)
        act(back=True)
        back = time.monotonic()
        took = await flows(robot, cloud, back, 15)
        if seconds > NOTICED_S + 1:
            noticed = robot.first("state", "waiting to retry", began)
            assert noticed is not None
            assert noticed - began < NOTICED_S
            gone = cloud.first("sessions", 0, began)
            assert gone is not None
            assert gone - began < NOTICED_S
        print(f"{seconds} {silently} {took:.2f}")
        assert took < BACK_S, f"{took:.2f} s after a cut of {seconds} s{' without a sign' if silently else ''}"
        for machine, topic in ((robot, "/down"), (cloud, "/up")):
            await machine.until(lambda m=machine, t=topic: len(m.heard(t, back)) > HZ, 5)
            once_and_in_order(machine, topic)
        await robot.until(lambda: [r["state"] for r in robot.status["routes"]] == ["active", "active"], 3)

    async with asyncio.TaskGroup() as group:
        for silently in (False, True):
            group.create_task(cut(silently))


async def test_killed_peer(pair: MakePair) -> None:
    """A gateway that is killed and started again gets everything back, whichever of the two it is."""
    net = await pair()
    robot, cloud = await two_gateways(net)
    began = time.monotonic()
    cloud.kill()
    await robot.until(lambda: robot.first("state", "waiting to retry", began), 1)  # the kernel tells at once
    await cloud.stop()
    cloud = await net.machine("b", **cloud.order)
    await flows(robot, cloud, time.monotonic(), BACK_S)
    robot.kill()
    began = time.monotonic()
    await cloud.until(lambda: cloud.first("sessions", 0, began), 1)
    await robot.stop()
    robot = await net.machine("a", **robot.order)
    await flows(robot, cloud, time.monotonic(), BACK_S)


async def test_wrong_clock(pair: MakePair) -> None:
    """A peer whose clock is wrong by hours is measured, and delays are told as they are."""
    net = await pair()
    robot, cloud = await two_gateways(net, ahead_s=7200.0)

    def delays() -> list[float | None]:
        return [
            *(route["delay_ms"] for route in robot.status["routes"]),
            *(t["delay_ms"] for s in cloud.status["sessions"] for t in s["topics"] if t["direction"] == "in"),
        ]

    await robot.until(lambda: len(delays()) == 3 and all(d is not None for d in delays()), 10)
    assert all(d is not None and -5 < d < 100 for d in delays()), delays()
