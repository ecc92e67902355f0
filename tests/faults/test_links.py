"""Links that are cut, peers that die, readers that stall, clocks that are wrong: two machines and what is between."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import time
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from ropeway import aio
from tests.faults.conftest import ROOT, Machine, Pair, took_s
from tests.support.messages import STRING

pytestmark = [pytest.mark.netns, pytest.mark.slow, pytest.mark.timeout(300)]

MakePair = Callable[[], Awaitable[Pair]]
NOTICED_S = 7.0  # what is promised is 5 s
BACK_S = 6.0  # what is promised is 2 s
HZ = 20.0
STALLED_S = 5.0


def item(name: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "type": STRING, **more}


async def two_gateways(pair: Pair, **robot: Any) -> tuple[Machine, Machine]:
    """The robot dials in to the cloud; a topic goes up, another comes down."""
    cloud = await pair.machine(
        "b", name="cloud", listen=[f"ws://{pair.address_b}:9090"], publish={"/down": HZ}, read=["/up"]
    )
    remote = {"address": f"ws://{pair.address_b}:9090", "publish": [item("/up")], "subscribe": [item("/down")]}
    machine = await pair.machine("a", name="robot", remotes=[remote], publish={"/up": HZ}, read=["/down"], **robot)
    await flows(machine, cloud, time.monotonic())
    return machine, cloud


async def flows(robot: Machine, cloud: Machine, since: float) -> float:
    """Wait until something came both ways; gives how long that took."""
    await robot.until(lambda: robot.heard("/down", since))
    await cloud.until(lambda: cloud.heard("/up", since))
    return took_s(since, max(robot.heard("/down", since)[0][0], cloud.heard("/up", since)[0][0]), robot, cloud)


async def noticed(machine: Machine, key: str, value: object, since: float) -> float:
    """Wait until something was told; gives how long that took."""
    await machine.until(lambda: machine.first(key, value, since))
    when = machine.first(key, value, since)
    assert when is not None
    return took_s(since, when, machine)


def once_and_in_order(machine: Machine, topic: str) -> None:
    numbers = [n for _, n in machine.heard(topic)]
    assert numbers == sorted(set(numbers))


async def cut(net: Pair, robot: Machine, cloud: Machine, seconds: float, silently: bool) -> None:
    """Cut the link for so long, and see that everything is as it should be during the cut and after."""
    act = net.swallow if silently else net.pull
    what = f"a cut of {seconds:g} s{' without a sign' if silently else ''}"
    act()
    began = time.monotonic()
    await asyncio.sleep(seconds)
    act(back=True)
    back = time.monotonic()
    took = await flows(robot, cloud, back)
    if seconds > NOTICED_S + 1:
        for machine, key, value in ((robot, "state", "waiting to retry"), (cloud, "sessions", 0)):
            when = await noticed(machine, key, value, began)
            assert when < NOTICED_S, f"{what} was noticed after {when:.2f} s"
    assert took < BACK_S, f"data after {took:.2f} s: {what}"
    for machine, topic in ((robot, "/down"), (cloud, "/up")):
        await machine.until(lambda m=machine, t=topic: len(m.heard(t, back)) > HZ)
        once_and_in_order(machine, topic)
    await robot.until(lambda: [r["state"] for r in robot.status["routes"]] == ["active", "active"])


async def test_cut_links(pair: MakePair) -> None:
    """A cut is noticed within 5 s on both sides, and data flows both ways within 2 s of the end of any cut."""

    async def cuts(seconds: tuple[float, ...], silently: bool) -> None:
        net = await pair()
        robot, cloud = await two_gateways(net)
        for one in seconds:
            await cut(net, robot, cloud, one, silently)

    async with aio.TaskGroup() as group:
        for silently in (False, True):
            group.create_task(cuts((20.0,), silently))
            group.create_task(cuts((0.7, 2.2, 3.1, 4.5), silently))


async def test_killed_peer(pair: MakePair) -> None:
    """A gateway that is killed and started again gets everything back, whichever of the two it is."""
    net = await pair()
    robot, cloud = await two_gateways(net)
    began = time.monotonic()
    cloud.kill()
    assert await noticed(robot, "state", "waiting to retry", began) < 1  # the kernel tells at once
    await cloud.stop()
    cloud = await net.machine("b", **cloud.order)
    assert await flows(robot, cloud, time.monotonic()) < BACK_S
    robot.kill()
    began = time.monotonic()
    assert await noticed(cloud, "sessions", 0, began) < 1
    await robot.stop()
    robot = await net.machine("a", **robot.order)
    assert await flows(robot, cloud, time.monotonic()) < BACK_S


async def test_wrong_clock(pair: MakePair) -> None:
    """A peer whose clock is wrong by hours is measured, and delays are told as they are."""
    net = await pair()
    robot, cloud = await two_gateways(net, ahead_s=7200.0)

    def delays() -> list[float | None]:
        return [
            *(route["delay_ms"] for route in robot.status["routes"]),
            *(t["delay_ms"] for s in cloud.status["sessions"] for t in s["topics"] if t["direction"] == "in"),
        ]

    await robot.until(lambda: len(delays()) == 3 and all(d is not None for d in delays()))
    assert all(d is not None and -5 < d < 100 for d in delays()), delays()


async def test_stopped_peer(pair: MakePair) -> None:
    """A peer that hangs costs the other remotes nothing and no memory; it is given up, and found again."""
    net = await pair()
    clouds = [
        await net.machine("b", name=f"cloud{i}", listen=[f"ws://{net.address_b}:909{i}"], read=["/up"]) for i in (0, 1)
    ]
    remotes = [{"address": f"ws://{net.address_b}:909{i}", "publish": [item("/up")]} for i in (0, 1)]
    robot = await net.machine("a", name="robot", remotes=remotes, publish={"/up": 30.0}, size=300_000)
    hung, well = clouds
    for cloud in clouds:
        await cloud.until(lambda c=cloud: len(c.heard("/up")) > 30)
    before = robot.memory_bytes
    began = time.monotonic()
    hung.process.send_signal(signal.SIGSTOP)
    assert await noticed(robot, "state", "waiting to retry", began) < NOTICED_S + 0.5
    await asyncio.sleep(2)
    numbers = [n for _, n in well.heard("/up", began)]
    assert len(numbers) > 0.9 * (numbers[-1] - numbers[0])
    assert robot.memory_bytes - before < 10 << 20
    hung.process.send_signal(signal.SIGCONT)
    back = time.monotonic()
    await hung.until(lambda: len(hung.heard("/up", back + 1)) > 30)
    assert [r["connections"] for r in robot.status["remotes"]] == [2, 1]


async def test_stalled_reader(pair: MakePair) -> None:
    """A client that stops reading costs no memory; others get every message, and operations are answered at once."""
    net = await pair()
    cloud = await net.machine("b", name="cloud", listen=["ws://127.0.0.1:9090"], publish={"/image": 30.0}, size=300_000)
    script = f"""
import asyncio, json, sys, time
from tests.support.websocket import Client
from tests.networks.rosbridge.server.test_session import listen
from tests.support.clock import queued_s

def elapsed():  # without the time in which this process or the server waited for a processor
    return time.monotonic() - queued_s() - queued_s({cloud.process.pid})

async def main():
    async with Client(9090) as good, Client(9090, receive_bytes=65536) as stalled, Client(9090) as control:
        for client in (stalled, good):
            client.send(listen("/image"))
        await control.done()
        print("ready", flush=True)
        began, numbers, slowest, asked = time.monotonic(), [], 0.0, 0.0
        while time.monotonic() - began < {STALLED_S}:
            numbers.append(int((await good.json())["msg"]["data"].split()[0]))
            if time.monotonic() - asked > 0.2:
                asked, at = time.monotonic(), elapsed()
                await control.done()
                slowest = max(slowest, elapsed() - at)
        got = [int((await stalled.json())["msg"]["data"].split()[0]) for _ in range(30)]
        print(json.dumps(dict(numbers=numbers, slowest=slowest, got=got)), flush=True)

asyncio.run(main())
"""
    process = await asyncio.create_subprocess_exec(
        *("ip", "netns", "exec", net.b, sys.executable, "-c", script), stdout=asyncio.subprocess.PIPE, cwd=ROOT
    )
    assert process.stdout is not None
    await process.stdout.readline()
    await asyncio.sleep(2)
    before = cloud.memory_bytes
    told = json.loads((await process.communicate())[0])
    numbers = told["numbers"]
    assert len(numbers) > 28 / 30 * (numbers[-1] - numbers[0])
    assert told["slowest"] < 0.25
    assert cloud.memory_bytes - before < 10 << 20
    assert told["got"] == sorted(set(told["got"]))
    assert told["got"][-1] >= numbers[-1] - 2 * 30, "what was sent after the pause is fresh"
