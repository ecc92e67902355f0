"""ropeway.bridge.topic: one topic from one network to another."""

from __future__ import annotations

import asyncio
import itertools
import logging
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.bridge.options import BridgeOptions
from ropeway.bridge.topic import TopicBridge
from ropeway.bridge.upkeep import RETRY_S
from ropeway.delivery.pipeline import Drop
from ropeway.errors import GraphUnavailable
from ropeway.graph.base import Delivery, Sample
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.until import until

pytestmark = pytest.mark.jumping

_numbers = itertools.count()


class Place:
    """Two networks with a gateway's participant on each, and a robot on each."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.number = next(_numbers)

    async def open(self) -> None:
        self.near, self.far = await self.participant("near", "/gateway"), await self.participant("far", "/gateway")
        self.here, self.there = await self.participant("near", "/robot"), await self.participant("far", "/robot")

    async def participant(self, network: str, node: str) -> MemoryGraph:
        graph = MemoryGraph(f"bridge-{network}-{self.number}", node=node)
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph

    async def bridge(
        self, source: str = "/x", target: str = "/x", *, retry_s: float = RETRY_S, **options: Any
    ) -> TopicBridge:
        made = TopicBridge(self.near, self.far, source, target, STRING, BridgeOptions(**options), retry_s=retry_s)
        await made.start()
        self.stack.push_async_callback(made.close)
        return made

    def offered(self, topic: str = "/x") -> list[QoS]:
        """The profiles with which the topic is published on the far network."""
        found = self.there.topics().get(topic)
        return [p.qos for p in found.publishers] if found else []


@pytest.fixture
async def place() -> AsyncIterator[Place]:
    async with AsyncExitStack() as stack:
        made = Place(stack)
        await made.open()
        yield made


async def test_passes_on(place: Place) -> None:
    """What is published on the source is published on the target, under its other name, byte for byte and in order."""
    bridge = await place.bridge("/x", "/robot1/x")
    inbox = Inbox()
    await place.there.create_subscription("/robot1/x", STRING, QoS(depth=100), inbox)
    publisher = await place.here.create_publisher("/x", STRING, QoS(depth=100))
    await until(lambda: publisher.subscribers == 1)
    for i in range(50):
        publisher.publish(sample(str(i)))
    await inbox.wait(50)
    assert inbox.payloads == [text(str(i)) for i in range(50)]
    assert len({s.seq for s in inbox.samples}) == 50
    assert bridge.meter.messages == 50
    assert bridge.meter.bytes == sum(len(p) for p in inbox.payloads)


async def test_reads_on_demand(place: Place) -> None:
    """The source is read only while somebody on the target does; the state says so."""
    bridge = await place.bridge()
    publisher = await place.here.create_publisher("/x", STRING)
    await until(lambda: bridge.state == "idle")
    assert publisher.subscribers == 0
    for _ in range(2):
        subscription = await place.there.create_subscription("/x", STRING, QoS(), Inbox())
        await until(lambda: publisher.subscribers == 1)
        assert bridge.state == "active"
        await subscription.close()
        await until(lambda: publisher.subscribers == 0)
        assert bridge.state == "idle"


async def test_latched(place: Place) -> None:
    """A latched topic is read at once and kept on the target, for late joiners there."""
    publisher = await place.here.create_publisher("/x", STRING, LATCHED)
    publisher.publish(sample("map"))
    await place.bridge()
    await until(lambda: place.offered() == [LATCHED])
    for _ in range(2):
        inbox = Inbox()
        await place.there.create_subscription("/x", STRING, LATCHED, inbox)
        await inbox.wait(1)
        assert inbox.payloads == [text("map")]


async def test_latched_publisher_comes_later(place: Place) -> None:
    """A reader that was there before the source turned out to be latched still gets what is latched, once."""
    bridge = await place.bridge()
    inbox = Inbox()
    await place.there.create_subscription("/x", STRING, None, inbox)
    await until(lambda: bridge.state == "active")
    publisher = await place.here.create_publisher("/x", STRING, LATCHED)
    publisher.publish(sample("map"))
    await inbox.wait(1)
    late = Inbox()
    await until(lambda: place.offered() == [LATCHED])
    await place.there.create_subscription("/x", STRING, LATCHED, late)
    await late.wait(1)
    await asyncio.sleep(0.05)
    assert late.payloads == [text("map")]


async def test_follows_the_profile(place: Place) -> None:
    """The target has what all publishers of the source offer together, as they come."""
    await place.bridge()
    await until(lambda: place.offered() == [QoS()])
    sensor = await place.here.create_publisher("/x", STRING, SENSOR_DATA)
    await until(lambda: [q.reliable for q in place.offered()] == [False])
    reliable = await place.here.create_publisher("/x", STRING, QoS(depth=50))
    await until(lambda: [(q.reliable, q.depth) for q in place.offered()] == [(False, 50)])
    await sensor.close()
    await until(lambda: [q.reliable for q in place.offered()] == [True])
    await reliable.close()
    inbox = Inbox()
    await place.there.create_subscription("/x", STRING, QoS(), inbox)
    again = await place.here.create_publisher("/x", STRING, QoS(depth=50))
    await until(lambda: again.subscribers == 1)
    again.publish(sample("still"))
    await inbox.wait(1)


async def test_profile_as_configured(place: Place) -> None:
    """A profile that the configuration names is used, whatever the source offers."""
    wanted = QoS(reliability="best_effort", depth=3)
    bridge = await place.bridge(qos=wanted)
    publisher = await place.here.create_publisher("/x", STRING, LATCHED)
    inbox = Inbox()
    await place.there.create_subscription("/x", STRING, SENSOR_DATA, inbox)
    await until(lambda: publisher.subscribers == 1)
    assert place.offered() == [wanted]
    assert bridge.subscription is not None
    assert bridge.subscription.qos == wanted


async def test_what_is_kept_for_a_time_only(place: Place) -> None:
    """What late joiners get for a second only, as rosbridge's clients publish, is not kept on the target for ever."""
    await place.bridge()
    rosbridge = QoS(durability="transient_local", depth=100, lifespan_s=1.0)
    publisher = await place.here.create_publisher("/x", STRING, rosbridge)
    inbox = Inbox()
    await place.there.create_subscription("/x", STRING, None, inbox)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("go"))
    await inbox.wait(1)
    assert [(q.transient_local, q.lifespan_s) for q in place.offered()] == [(False, None)]
    late = Inbox()
    await place.there.create_subscription("/x", STRING, None, late)
    publisher.publish(sample("stop"))
    await late.wait(1)
    assert late.payloads == [text("stop")]


async def test_limits(place: Place) -> None:
    """Rate and lifespan are kept on the near side, and what they drop is counted; the far side does not drop again."""
    delivery = Delivery(rate_hz=0.01, lifespan_s=60.0)
    bridge = await place.bridge(delivery=delivery)
    far_side = await place.bridge("/y", "/y", delivery=delivery, limit=False)
    inboxes = Inbox(), Inbox()
    publishers = []
    for name, inbox in zip(("/x", "/y"), inboxes, strict=True):
        await place.there.create_subscription(name, STRING, QoS(), inbox)
        publisher = await place.here.create_publisher(name, STRING)
        await until(lambda p=publisher: p.subscribers == 1)
        publishers.append(publisher)
    old = Sample(text("old"), STRING, time.time_ns() - 61_000_000_000, b"o" * 16, 1)
    for publisher in publishers:
        publisher.publish(old)
        for i in range(3):
            publisher.publish(sample(str(i)))
    await inboxes[1].wait(4)
    assert inboxes[0].payloads == [text("0")]
    assert bridge.drops == {Drop.EXPIRED: 1, Drop.RATE: 2}
    assert not far_side.drops


async def test_refused_by_the_target(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    """A target that refuses is asked again until it takes the topic; the reason is told once."""
    caplog.set_level(logging.INFO)
    await place.far.close()
    bridge = await place.bridge(retry_s=0.02)
    await until(lambda: bridge.state == "failed")
    assert "is not open" in bridge.error
    await asyncio.sleep(0.1)
    assert len([m for m in caplog.messages if "is not open" in m]) == 1
    await place.far.open()
    await until(lambda: bridge.state == "idle")
    assert bridge.error == ""


async def test_gone_source(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """A source that cannot be read is an error of the bridge, not of its owner."""
    refusing = True
    create = place.near.create_subscription

    async def refuse(*args: Any, **more: Any) -> Any:
        if refusing:
            raise GraphUnavailable("memory:near", "no")
        return await create(*args, **more)

    monkeypatch.setattr(place.near, "create_subscription", refuse)
    bridge = await place.bridge(retry_s=0.02)
    inbox = Inbox()
    await place.there.create_subscription("/x", STRING, QoS(), inbox)
    await until(lambda: bridge.error == "memory:near: no")
    refusing = False
    publisher = await place.here.create_publisher("/x", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("x"))
    await inbox.wait(1)


@pytest.mark.parametrize("at", ["create_publisher", "changes"])
async def test_a_graph_that_fails_unforeseen(place: Place, monkeypatch: pytest.MonkeyPatch, at: str) -> None:
    """An exception that no graph should raise is shown as the state of the bridge, which works once it stops."""
    graph = place.far if at == "create_publisher" else place.near
    right = getattr(graph, at)
    calls = 0

    def fail(*args: Any, **more: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls > 2:
            return right(*args, **more)
        raise KeyError("no such thing")

    monkeypatch.setattr(graph, at, fail)
    bridge = await place.bridge(retry_s=0.02)
    await until(lambda: bridge.state == "failed")
    assert bridge.error == "KeyError: 'no such thing'"
    inbox = Inbox()
    await place.there.create_subscription("/x", STRING, QoS(), inbox)
    publisher = await place.here.create_publisher("/x", STRING)
    await until(lambda: publisher.subscribers == 1)
    assert bridge.error == ""
    publisher.publish(sample("x"))
    await inbox.wait(1)


async def test_close(place: Place) -> None:
    """A closed bridge leaves nothing on either side, however early it is closed."""
    for wait in (False, True):
        bridge = TopicBridge(place.near, place.far, "/x", "/x", STRING)
        await bridge.start()
        if wait:
            await place.there.create_subscription("/x", STRING, QoS(), Inbox())
            await until(lambda b=bridge: b.state == "active")
        await bridge.close()
        await bridge.close()
        assert bridge.state == "waiting"
        assert not place.offered()
        known = place.here.topics().get("/x")
        assert known is None or not known.subscriptions
        bridge.passage.pass_on([sample("late")])
        assert bridge.drops == {Drop.INACTIVE: 1}


async def test_a_tap_gets_what_crosses(place: Place) -> None:
    """A tap gets what has passed, not what a limit dropped; it can be put in and taken out while messages pass."""
    got: list[bytes] = []

    def tap(sample: Sample) -> None:
        got.append(sample.payload)

    bridge = await place.bridge(delivery=Delivery(rate_hz=1), tap=tap)
    inbox = Inbox()
    await place.there.create_subscription("/x", STRING, None, inbox)
    publisher = await place.here.create_publisher("/x", STRING)
    await until(lambda: bridge.state == "active")
    for number in range(3):
        publisher.publish(sample(str(number)))
    await until(lambda: len(inbox.samples) == 1)
    assert got == [text("0")]
    await bridge.change(BridgeOptions())
    publisher.publish(sample("4"))
    await until(lambda: len(inbox.samples) == 2)
    assert len(got) == 1
