"""What every kind of graph does with topics."""

from __future__ import annotations

import asyncio

import pytest

from ropeway import aio
from ropeway.errors import GraphUnavailable, InvalidName
from ropeway.graph.base import Graph, Publisher, Subscription, look_up
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING, joined, sample, text
from tests.support.until import until

from .conftest import Pair


async def test_protocols(pair: Pair) -> None:
    """A graph and its parts satisfy the protocols."""
    assert isinstance(pair.near, Graph)
    publisher = await pair.near.create_publisher("/t", STRING)
    subscription = await pair.near.create_subscription("/t", STRING, None, lambda _: None)
    assert isinstance(publisher, Publisher)
    assert isinstance(subscription, Subscription)


async def test_delivers(pair: Pair) -> None:
    """What one participant publishes arrives at the other, byte for byte and in order."""
    inbox = Inbox()
    subscription = await pair.far.create_subscription("/chatter", STRING, QoS(depth=100), inbox)
    publisher = await pair.near.create_publisher("/chatter", STRING, QoS(depth=100))
    await joined(publisher, read_by=[subscription])
    for i in range(50):
        publisher.publish(sample(f"message {i}"))
    got = await inbox.wait(50)
    assert [pair.exactly(s.payload, STRING) for s in got] == [text(f"message {i}") for i in range(50)]
    assert {s.type for s in got} == {STRING}
    assert len({(s.origin, s.seq) for s in got}) == 50
    assert all(len(s.origin) == 16 for s in got)
    await subscription.close()


async def test_publishers_are_counted(pair: Pair) -> None:
    """The numbers of others' and of our own publishers are those of the description of the topic."""
    subscription = await pair.far.create_subscription("/counted", STRING, QoS(), Inbox())
    publisher = await pair.near.create_publisher("/counted", STRING)
    await joined(publisher, read_by=[subscription])
    for graph in (pair.near, pair.far):
        known = look_up(graph, "topic", "/counted")
        own = [end.local for end in known.publishers] if known is not None else []
        assert graph.count_publishers("/counted") == (own.count(False), own.count(True))
        assert graph.count_publishers("/nobody") == (0, 0)


async def test_other_direction(pair: Pair) -> None:
    """Both participants can publish and subscribe at once."""
    inbox = Inbox()
    subscription = await pair.near.create_subscription("/back", STRING, QoS(), inbox)
    publisher = await pair.far.create_publisher("/back", STRING)
    await joined(publisher, read_by=[subscription])
    publisher.publish(sample("hello"))
    await inbox.wait(1)


async def test_big_message(pair: Pair) -> None:
    """A message of 13 MB arrives whole."""
    inbox = Inbox()
    subscription = await pair.far.create_subscription("/cloud", STRING, QoS(depth=2), inbox)
    publisher = await pair.near.create_publisher("/cloud", STRING, QoS(depth=2))
    await joined(publisher, read_by=[subscription])
    big = sample("x" * 13_000_000)
    publisher.publish(big)
    got = await inbox.wait(1, 30)
    assert pair.exactly(got[0].payload, STRING) == big.payload


async def test_own_samples_ignored(pair: Pair) -> None:
    """A participant does not hear itself."""
    own, other = Inbox(), Inbox()
    await pair.near.create_subscription("/self", STRING, QoS(), own)
    subscription = await pair.far.create_subscription("/self", STRING, QoS(), other)
    publisher = await pair.near.create_publisher("/self", STRING)
    await joined(publisher, read_by=[subscription])
    publisher.publish(sample("hello"))
    await other.wait(1)
    assert own.samples == []


async def test_transient_local(pair: Pair) -> None:
    """A late joiner gets what was published before, once, where both sides are transient local."""
    publisher = await pair.near.create_publisher("/map", STRING, LATCHED)
    publisher.publish(sample("old"))
    publisher.publish(sample("map"))
    await until(lambda: "/map" in pair.far.topics())
    inbox = Inbox()
    await pair.far.create_subscription("/map", STRING, LATCHED, inbox)
    await inbox.wait(1)
    later = Inbox()
    await pair.far.create_subscription("/map", STRING, LATCHED, later)
    await later.wait(1)
    for box in (inbox, later):
        assert [pair.exactly(payload, STRING) for payload in box.payloads] == [text("map")]


async def test_adopted_qos(pair: Pair) -> None:
    """A subscription without a profile takes the publisher's: latched data comes, best effort matches."""
    latched = await pair.near.create_publisher("/latched", STRING, LATCHED)
    latched.publish(sample("kept"))
    await until(lambda: "/latched" in pair.far.topics())
    inbox = Inbox()
    subscription = await pair.far.create_subscription("/latched", STRING, None, inbox)
    await inbox.wait(1)
    await until(lambda: subscription.qos.transient_local)

    sensor = await pair.near.create_publisher("/sensor", STRING, SENSOR_DATA)
    await until(lambda: "/sensor" in pair.far.topics())
    readings = Inbox()
    reader = await pair.far.create_subscription("/sensor", STRING, None, readings)
    await joined(sensor, read_by=[reader])
    sensor.publish(sample("1"))
    await readings.wait(1)


async def test_adopts_later(pair: Pair) -> None:
    """A subscription that waits for its publisher adopts the profile when it comes, and loses nothing latched."""
    inbox = Inbox()
    profiles: list[QoS] = []
    subscription = await pair.far.create_subscription("/later", STRING, None, inbox)
    subscription.on_qos(profiles.append)
    publisher = await pair.near.create_publisher("/later", STRING, LATCHED)
    publisher.publish(sample("kept"))
    await inbox.wait(1)
    await until(lambda: subscription.qos.transient_local)
    assert profiles[-1].transient_local
    publisher.publish(sample("later"))
    await inbox.wait(2)
    assert [pair.exactly(payload, STRING) for payload in inbox.payloads] == [text("kept"), text("later")]


async def test_discovery(pair: Pair) -> None:
    """Topics, types and endpoints of the other participant are seen, and vanish when closed."""
    publisher = await pair.near.create_publisher("/seen", STRING, LATCHED)
    await until(lambda: "/seen" in pair.far.topics() and pair.far.topics()["/seen"].publishers)
    topic = pair.far.topics()["/seen"]
    assert topic.type == STRING
    (endpoint,) = topic.publishers
    assert endpoint.qos.transient_local or not pair.can.shows_qos
    assert not endpoint.local
    await publisher.close()
    await until(lambda: "/seen" not in pair.far.topics() or not pair.far.topics()["/seen"].publishers)


async def test_changes(pair: Pair) -> None:
    """Discovery is also told as events that read as sentences."""
    events = []

    async def listen() -> None:
        async for event in pair.far.changes():
            if event.name == "/told":
                events.append(event)
                if not event.discovered:
                    return

    async with aio.TaskGroup() as group:
        group.create_task(listen())
        await asyncio.sleep(0)
        publisher = await pair.near.create_publisher("/told", STRING)
        await until(lambda: events)
        await publisher.close()
        await until(lambda: len(events) >= 2)
    assert "publishes /told" in str(events[0])
    assert "no longer publishes /told" in str(events[-1])


async def test_demand(pair: Pair) -> None:
    """A publisher learns when readers come and go, where the network can tell."""
    counts: list[int] = []
    publisher = await pair.near.create_publisher("/wanted", STRING)
    assert (publisher.subscribers is not None) is pair.can.demand
    if not pair.can.demand:
        return
    publisher.on_demand(counts.append)
    assert counts == [0]
    subscription = await pair.far.create_subscription("/wanted", STRING, QoS(), lambda _: None)
    await until(lambda: counts[-1] == 1)
    await subscription.close()
    await until(lambda: counts[-1] == 0)


async def test_failing_callback(pair: Pair) -> None:
    """A callback that raises is counted and costs no other reader a message."""

    def fail(_: object) -> None:
        raise RuntimeError("broken reader")

    inbox = Inbox()
    failing = await pair.far.create_subscription("/x", STRING, QoS(), fail)
    subscription = await pair.far.create_subscription("/x", STRING, QoS(), inbox)
    publisher = await pair.near.create_publisher("/x", STRING)
    await joined(publisher, read_by=[failing, subscription])
    publisher.publish(sample("a"))
    await inbox.wait(1)
    await until(lambda: sum(pair.far.drops.values()) == 1)


async def test_closed_parts(pair: Pair) -> None:
    """Closing twice is harmless, and a closed subscription gets nothing more."""
    inbox = Inbox()
    subscription = await pair.far.create_subscription("/c", STRING, QoS(), inbox)
    keep = Inbox()
    kept = await pair.far.create_subscription("/c", STRING, QoS(), keep)
    publisher = await pair.near.create_publisher("/c", STRING)
    await joined(publisher, read_by=[subscription, kept])
    publisher.publish(sample("1"))
    await keep.wait(1)
    await inbox.wait(1)
    await subscription.close()
    await subscription.close()
    publisher.publish(sample("2"))
    await keep.wait(2)
    assert [pair.exactly(payload, STRING) for payload in inbox.payloads] == [text("1")]
    await publisher.close()
    await publisher.close()
    publisher.publish(sample("3"))


async def test_bad_names(pair: Pair) -> None:
    """A name that ROS would refuse is refused, with the rule."""
    for name in ("", "/a//b", "/1st", "/with space", "/trailing/", "~/private"):
        with pytest.raises(InvalidName):
            await pair.near.create_publisher(name, STRING)


async def test_needs_open(pair: Pair) -> None:
    """A closed graph says so."""
    await pair.near.close()
    with pytest.raises(GraphUnavailable):
        await pair.near.create_publisher("/t", STRING)
