"""ropeway.hub.redundancy: one of two gateways speaks, the other stands by."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.graph.base import EndpointInfo, Sample, TopicInfo
from ropeway.graph.deduplication import Seen
from ropeway.hub.redundancy import Standby
from ropeway.qos import QoS
from tests.support.messages import STRING, text
from tests.support.until import until

pytestmark = pytest.mark.jumping

US = "m"  # our id; the smaller one speaks


class Network:
    """A graph with publishers as a test wants them."""

    name = "dds:0"

    def __init__(self) -> None:
        self.gateways: list[str] = []
        self.monitors: list[Any] = []
        self.subscribed = 0
        self.broken = False

    def topics(self) -> dict[str, TopicInfo]:
        ours = EndpointInfo("publisher", "/x", STRING, QoS(), gateway=US, local=True)
        others = [EndpointInfo("publisher", "/x", STRING, QoS(), gateway=g) for g in self.gateways]
        return {"/x": TopicInfo("/x", (STRING,), (ours, *others))}

    def look_up(self, kind: str, name: str) -> TopicInfo | None:
        return self.topics().get(name)

    async def create_subscription(self, topic: str, type: str, qos: QoS | None, callback: Any, **_: Any) -> Any:
        await asyncio.sleep(0)
        if self.broken:
            raise GraphUnavailable(self.name, "no readers today")
        self.monitors.append(callback)
        self.subscribed += 1
        return self

    async def close(self) -> None:
        """Stands for the subscription as well."""
        self.monitors.pop()

    def hears(self, *samples: Sample) -> None:
        """Others publish."""
        for monitor in self.monitors:
            monitor(samples)


def sample(seq: int, *, relayed: bool = False) -> Sample:
    return Sample(text(str(seq)), STRING, seq, b"o" * 16, seq, relayed)


class Place:
    def __init__(self) -> None:
        self.network = Network()
        self.received, self.given = Seen(), Seen()
        graph: Any = self.network
        self.standby = Standby(graph, US, "/x", STRING, self.received, self.given)
        self.published: list[int] = []

    async def others(self, *gateways: str) -> None:
        self.network.gateways = list(gateways)
        await self.standby.look()

    def publish(self, *seqs: int) -> None:
        """As ``ViewPublisher.publish`` does."""
        for seq in seqs:
            self.given.add(sample(seq))
            if self.standby.defers:
                self.standby.hold(sample(seq), self._publish)
            else:
                self._publish(sample(seq))

    def _publish(self, message: Sample) -> None:
        self.published.append(message.seq)


@pytest.fixture
def place() -> Place:
    return Place()


async def test_alone(place: Place) -> None:
    """Where nobody else publishes the topic, it is published at once and not read."""
    await place.others()
    place.publish(1)
    assert place.published == [1]
    assert place.network.subscribed == 0


async def test_ordinary_publishers(place: Place) -> None:
    """Beside an ordinary node we publish at once, and read what it says, so that it is known."""
    await place.others("")
    assert not place.standby.defers
    place.network.hears(sample(7))
    assert place.received.has(sample(7))
    await place.others("")
    assert place.network.subscribed == 1
    await place.others()
    assert place.network.monitors == []


async def test_speaks(place: Place) -> None:
    """The gateway with the smallest id publishes at once."""
    await place.others("n", "z", US)
    assert not place.standby.defers
    place.publish(1)
    assert place.published == [1]


async def test_stands_by(place: Place) -> None:
    """Beside a gateway with a smaller id, only what it does not publish in time is published, in order."""
    await place.others("a", "z")
    assert place.standby.defers
    place.publish(1, 2, 3, 4)
    place.network.hears(sample(1), sample(3))
    assert place.published == []
    await until(lambda: len(place.published) == 2, 1)
    assert place.published == [2, 4]
    assert place.standby.duplicates == 2
    place.publish(5)
    await until(lambda: place.published[-1] == 5, 1)


async def test_different_messages(place: Place) -> None:
    """Where the other brings other messages under the same name, ours go out at once, until it brings ours again."""
    await place.others("a")
    for seq in range(1, 40):
        place.publish(seq)
        place.network.hears(sample(1000 + seq, relayed=True))
    await until(lambda: not place.standby.defers, 1)
    assert place.published == list(range(1, 40))
    place.publish(40)
    assert place.published[-1] == 40
    place.network.hears(sample(40, relayed=True))
    assert place.standby.defers
    place.publish(41)
    assert place.published[-1] == 40


async def test_ring(place: Place) -> None:
    """A message that came round waits a moment, so that we have heard it if it is from here."""
    await place.others("")
    assert place.standby.listens
    place.standby.hold(sample(1, relayed=True), place._publish)
    place.standby.hold(sample(2, relayed=True), place._publish)
    place.network.hears(sample(1))
    await until(lambda: place.published, 1)
    assert place.published == [2]
    assert not place.standby.defers


async def test_takes_over(place: Place) -> None:
    """When the other leaves, what is held goes out at once, before anything newer."""
    await place.others("a")
    place.publish(1, 2)
    place.network.hears(sample(1))
    await place.others()
    place.publish(3)
    assert place.published == [2, 3]
    assert place.network.monitors == []
    await asyncio.sleep(0.05)
    assert place.published == [2, 3]


async def test_deaf(place: Place) -> None:
    """A gateway that cannot hear the others does not wait for them."""
    place.network.broken = True
    await place.others("a")
    assert not place.standby.defers
    place.network.broken = False
    await place.others("a")
    assert place.standby.defers


async def test_holds_so_many(place: Place) -> None:
    """Of a fast topic only so many messages are held; the oldest then go out early, in order."""
    await place.others("a")
    place.publish(*range(1, 1001))
    assert len(place.standby._held) <= 256
    await until(lambda: len(place.published) == 1000, 1)
    assert place.published == list(range(1, 1001))


async def test_close(place: Place) -> None:
    """Closing sends what is held and stops reading, for good."""
    await place.others("a")
    place.publish(1, 2)
    await asyncio.gather(place.standby.close(), place.standby.look())
    assert place.published == [1, 2]
    await place.others("a", "b")
    await place.others()
    assert place.network.monitors == []
    assert place.network.subscribed == 1
    await place.standby.close()


async def test_looks_do_not_overlap(place: Place) -> None:
    """Changes that come while the topic is being looked at make no second reader."""
    place.network.gateways = ["a"]
    await asyncio.gather(*(place.standby.look() for _ in range(5)))
    assert place.network.subscribed == 1
    seen: Sequence[Any] = place.network.monitors
    assert len(seen) == 1
