"""Gateways side by side on real DDS networks: parallel links help and never echo."""

from __future__ import annotations

import asyncio
import itertools
import time
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.networks.dds import DdsGraph
from ropeway.qos import QoS
from tests.faults.conftest import Machine
from tests.support.messages import STRING, text
from tests.support.until import until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]  # each starts five gateways
_domains = itertools.cycle(range(110, 120))
HZ = 50.0


class Network:
    """A DDS domain, and a robot on it that talks and listens."""

    def __init__(self) -> None:
        self.domain = next(_domains)
        self.url = f"dds:{self.domain}?interface=lo"
        self.heard: list[int] = []
        self.sent = 0

    async def open(self, stack: AsyncExitStack) -> None:
        self.graph = DdsGraph(self.domain, name="robot", interface="lo")
        await self.graph.open()
        stack.push_async_callback(self.graph.close)

    async def listen(self) -> None:
        await self.graph.create_subscription("/x", STRING, QoS(depth=1000), self._hear)

    def _hear(self, batch: Any) -> None:
        self.heard += [int(bytes(s.payload[8:]).split(b"\0")[0]) for s in batch]

    async def advertise(self) -> None:
        self.publisher = await self.graph.create_publisher("/x", STRING, QoS(depth=1000))

    async def say(self, count: int) -> None:
        began = time.monotonic()
        for i in range(count):
            self.sent += 1
            self.publisher.publish(Sample(text(str(self.sent)), STRING, time.time_ns(), bytes(16), SEQ_NONE))
            await asyncio.sleep(max(0.0, began + (i + 1) / HZ - time.monotonic()))


async def gateway(stack: AsyncExitStack, name: str, network: Network, remotes: list[dict[str, Any]]) -> Machine:
    """A gateway in a process of its own."""
    machine = Machine(None, {"name": name, "graph": network.url, "listen": ["ws://127.0.0.1:0"], "remotes": remotes})
    await machine.start()
    stack.push_async_callback(machine.stop)
    return machine


def address(machine: Machine) -> str:
    (port,) = next(e["ready"] for e in machine.events if "ready" in e)
    return f"ws://127.0.0.1:{port}"


async def two_networks(stack: AsyncExitStack) -> tuple[Network, Network]:
    networks = Network(), Network()
    for network in networks:
        await network.open(stack)
    return networks


async def heard_once(network: Network, wanted: range) -> None:
    """All of these messages come, each once; in their order but for those around the death of a gateway."""
    await until(lambda: len(set(network.heard)) >= len(wanted))
    await asyncio.sleep(0.3)  # a second copy would come within the 100 ms that a gateway stands by
    assert sorted(network.heard) == list(wanted)
    strays = sum(later < sooner for sooner, later in itertools.pairwise(network.heard))
    assert strays <= 6, network.heard


async def test_two_pairs(stack: AsyncExitStack) -> None:
    """A topic that two pairs of gateways forward arrives once; when parts of a pair die, it goes on without loss."""
    a, b = await two_networks(stack)
    item = {"name": "/x", "type": STRING}
    far = [await gateway(stack, f"b{i}", b, []) for i in (1, 2)]
    near = [
        await gateway(stack, f"a{i}", a, [{"address": address(m), "publish": [item]}]) for i, m in enumerate(far, 1)
    ]
    await b.listen()
    await a.advertise()
    await until(lambda: a.publisher.subscribers == 2)
    await asyncio.sleep(1)  # those side by side have found each other
    await a.say(50)
    assert b.heard == sorted(b.heard)
    await heard_once(b, range(1, 51))
    for index, victim in ((0, near[0]), (1, far[1])):
        saying = asyncio.create_task(a.say(60))
        await asyncio.sleep(0.5)
        victim.kill()
        await saying
        await heard_once(b, range(1, a.sent + 1))
        if index == 0:  # the dead half of the first pair returns, before the other pair dies
            near[0] = await gateway(stack, "a1", a, near[0].order["remotes"])
            await near[0].until(lambda: near[0].status["routes"][0]["state"] == "active")
            await asyncio.sleep(1)
            await a.say(25)
            await heard_once(b, range(1, a.sent + 1))


async def test_both_ways(stack: AsyncExitStack) -> None:
    """Two pairs that forward a topic both ways give every message once on each side, and no echo."""
    a, b = await two_networks(stack)
    item = {"name": "/x", "type": STRING}
    for i in (1, 2):
        far = await gateway(stack, f"b{i}", b, [])
        remote = {"address": address(far), "publish": [item], "subscribe": [item]}
        await gateway(stack, f"a{i}", a, [remote])
    for network in (a, b):
        await network.listen()
        await network.advertise()
    await until(lambda: min(a.publisher.subscribers or 0, b.publisher.subscribers or 0) >= 2)
    await asyncio.sleep(1)  # every gateway has found the others
    a.heard.clear()
    b.heard.clear()
    b.sent = 1000
    await asyncio.gather(a.say(40), b.say(40))
    await heard_once(b, range(1, 41))
    await heard_once(a, range(1001, 1041))
