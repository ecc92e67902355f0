"""ropeway.group.links: two links to one gateway on a clock that jumps, one of which is cut without a sign."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import pytest

from ropeway.graph.base import NO_HINTS, Delivery, Sample, SampleCallback
from ropeway.group.link_choice import PROBE_S
from ropeway.group.links import LinkGroup
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import QoS
from tests.support.messages import STRING, sample

pytestmark = pytest.mark.jumping

PERIOD_S = 0.02


class Link(MemoryGraph):
    """A link with a delay, which carries nothing once it is cut."""

    numbers = True

    def __init__(self, delay_s: float) -> None:
        super().__init__("links", node="/robot")
        self.delay_s, self.cut = delay_s, False
        self.readers: dict[str, SampleCallback] = {}
        self.carried: list[tuple[float, int]] = []
        self._callbacks: list[Callable[[float], None]] = []

    def later(self, trips: int, work: Callable[[], object]) -> None:
        if not self.cut:
            asyncio.get_running_loop().call_later(trips * self.delay_s, lambda: None if self.cut else work())

    def probe(self) -> None:
        for callback in self._callbacks:
            self.later(2, partial(callback, 2 * self.delay_s))

    def on_probe(self, callback: Callable[[float], None]) -> None:
        self._callbacks.append(callback)

    def on_reached(self, callback: Callable[[bool], None]) -> None:
        callback(True)

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> Any:
        part: Any = await super().create_publisher(topic, type, qos, delivery=delivery)
        part.publish = lambda one: self.later(1, partial(self._arrived, one))
        return part

    def _arrived(self, one: Sample) -> None:
        self.carried.append((asyncio.get_running_loop().time(), one.seq))

    async def create_subscription(
        self, topic: str, type: str, qos: QoS | None, callback: SampleCallback, *, delivery: Delivery = NO_HINTS
    ) -> Any:
        part: Any = await super().create_subscription(topic, type, qos, callback, delivery=delivery)
        close = part.close

        async def end() -> None:
            self.later(1, partial(self.readers.pop, topic, None))
            await close()

        part.close = end
        self.later(1, partial(self.readers.__setitem__, topic, callback))
        return part

    def send(self, topic: str, one: Sample) -> None:
        """Have the far side publish a message."""
        if topic in self.readers:
            self.later(1, partial(self.readers[topic], (one,)))


class Two:
    """A robot with a quick and a slow link; messages go both ways, and are noted as they arrive."""

    def __init__(self, *, duplicate: bool = False) -> None:
        self.links = {"quick": Link(0.01), "slow": Link(0.04)}
        self.group = LinkGroup(self.links, duplicate=duplicate)
        self.down: list[tuple[float, int]] = []

    async def run(self, seconds: float, start: int = 1) -> int:
        """Send both ways for a time; return the number of the next message."""
        for number in range(start, start + round(seconds / PERIOD_S)):
            one = sample(str(number), seq=number)
            self.publisher.publish(one)
            for link in self.links.values():
                link.send("/down", one)
            await asyncio.sleep(PERIOD_S)
        return start + round(seconds / PERIOD_S)

    async def __aenter__(self) -> Two:
        await self.group.open()
        self.publisher = await self.group.create_publisher("/up", STRING, QoS(depth=100))
        await self.group.create_subscription("/down", STRING, QoS(depth=100), self._came)
        return self

    def _came(self, batch: Sequence[Sample]) -> None:
        now_s = asyncio.get_running_loop().time()
        self.down += [(now_s, one.seq) for one in batch]

    async def __aexit__(self, *_: object) -> None:
        await self.group.close()

    @property
    def up(self) -> list[tuple[float, int]]:
        """What came at the far side, each message once."""
        came: dict[int, float] = {}
        for at_s, number in sorted(pair for link in self.links.values() for pair in link.carried):
            came.setdefault(number, at_s)
        return sorted((at_s, number) for number, at_s in came.items())


def gap_s(came: Sequence[tuple[float, int]]) -> float:
    """Return the longest time without a message."""
    return max(later - sooner for (sooner, _), (later, _) in itertools.pairwise(came))


@pytest.mark.parametrize("tick", range(0, 25, 4))
async def test_a_cut(tick: int) -> None:
    """A link that is cut at any moment between two probes is doubted before two more are due: nothing that is sent is
    lost, and what is read comes by the other link a round trip later.
    """
    async with Two() as two:
        following = await two.run(2)
        assert two.group.scheduler.current == "quick"
        await asyncio.sleep(tick / 1e3)
        two.links["quick"].cut = True
        following = await two.run(1, following)
        await asyncio.sleep(0.1)
    slow = two.links["slow"]
    doubt_s = 2 * PROBE_S + 2 * two.links["quick"].delay_s
    pause_s = tick / 1e3  # nothing was sent in it
    assert gap_s(two.up) <= doubt_s + slow.delay_s + PERIOD_S + pause_s
    assert gap_s(two.down) <= doubt_s + 2 * slow.delay_s + 2 * PERIOD_S + pause_s
    assert [number for _, number in two.up] == list(range(1, following))
    for came in (two.up, two.down):
        assert came[-1][1] == following - 1


@pytest.mark.parametrize("tick", range(0, 25, 8))
async def test_a_cut_with_duplicates(tick: int) -> None:
    """With duplicates a cut costs no more than a period and the difference of the links, and nothing is lost."""
    async with Two(duplicate=True) as two:
        following = await two.run(2)
        await asyncio.sleep(tick / 1e3)
        two.links["quick"].cut = True
        following = await two.run(1, following)
        await asyncio.sleep(0.1)
    between_s = two.links["slow"].delay_s - two.links["quick"].delay_s
    for came in (two.up, two.down):
        assert gap_s(came) <= PERIOD_S + between_s + tick / 1e3 + 1e-6
        assert came[-1][1] == following - 1
    assert [number for _, number in two.up] == list(range(1, following))


async def test_a_doubt_that_was_none() -> None:
    """While a probe is late everything goes by both links, each message counts once, and the link in use stays."""
    async with Two() as two:
        following = await two.run(2)
        two.links["quick"].delay_s = 0.03  # for a moment
        following = await two.run(0.1, following)
        two.links["quick"].delay_s = 0.01
        assert two.group.status()["beside"] == "slow"
        following = await two.run(1, following)
        assert two.group.status()["beside"] == ""
        assert two.group.scheduler.current == "quick"
        await two.run(1, following)
        assert "/down" not in two.links["slow"].readers
    numbers = [number for _, number in two.down]
    assert len(numbers) == len(set(numbers))
