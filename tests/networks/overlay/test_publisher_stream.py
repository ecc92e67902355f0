"""What one publisher sends, by several ways."""

from __future__ import annotations

from typing import Any, NamedTuple

from ropeway.networks.overlay.feed import Feed, catch_up
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.graph.publisher import OverlayPublisher
from ropeway.networks.overlay.packet_mark import Mark, by_way
from ropeway.networks.overlay.refusal import Refusal
from ropeway.qos import QoS
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.conftest import site as site
from tests.support.inbox import Inbox
from tests.support.messages import STRING
from tests.support.messages import sample as text
from tests.support.until import until


class Sides(NamedTuple):
    """Two members: the publisher of one, and what the other gets of it, by which feed."""

    near: OverlayGraph
    far: OverlayGraph
    publisher: OverlayPublisher
    inbox: Inbox
    feed: Feed


async def joined(site: Site) -> Sides:
    """Return two members of which one reads from the other."""
    near, far = await site.join(), await site.join()
    inbox = Inbox()
    await far.create_subscription("/a", STRING, QoS(depth=10), inbox)
    publisher = await near.create_publisher("/a", STRING, QoS(depth=10))
    await until(lambda: publisher.subscribers)
    (feed,) = far.node.feeds.values()
    return Sides(near, far, publisher, inbox, feed)


async def test_a_second_copy_is_no_attack(site: Site) -> None:
    """A packet is delivered once; by another way of its sender, or of ours, it is a copy, and everything else a replay.

    Ways that its sender does not have count as the first.
    """
    near, far, publisher, inbox, feed = await joined(site)
    feed._ways = lambda _: 2
    came: list[tuple[str, Any, Any]] = []
    take = Feed.came.__get__(feed)
    end = far.node.fabric.subscribe("rw/d/**", lambda key, raw, mark, way: came.append((key, raw, mark)))
    number = 0
    while not came:
        number += 1
        publisher.publish(text(str(number)))
        await inbox.wait(number)
    end()
    key, raw, mark = came[0]
    before = len(inbox.samples)
    take(key, raw, by_way(bytes(mark), 1), 0)
    take(key, raw, bytes(mark), 1)
    await until(lambda: feed.copies == 2)
    assert not far.node.refusals
    assert far.node.status()["copies"] == 2
    for again in (by_way(bytes(mark), 1), bytes(mark), by_way(bytes(mark), 2)):
        take(key, raw, again, 0)
    await until(lambda: far.node.refusals[near.node.identity.name, Refusal.REPLAYED] == 3)
    assert feed.copies == 2
    assert len(inbox.samples) == before


async def test_parts_by_several_ways(site: Site) -> None:
    """The parts of a packet are put together way by way, so that those of a copy do not end the packet."""
    _, _, publisher, _, feed = await joined(site)
    packet = publisher.source.seal([publisher.packing.pack(publisher.add(text("x" * 1000)), False)])
    (stream,) = feed.streams.values()
    half = len(packet) // 2
    for way in ((0, 0), (1, 0)):
        assert stream.assemble(Mark(4, 1, 0, len(packet)), packet[:half], way) is None
    for way in ((1, 0), (0, 0)):
        assert stream.assemble(Mark(4, 2, half, len(packet)), packet[half:], way) == packet


async def test_what_may_be_lost(site: Site) -> None:
    """What may have been lost is asked for before a gap shows; what was had is not delivered twice."""
    _, far, publisher, inbox, feed = await joined(site)
    publisher.publish(text("0"))
    await inbox.wait(1)
    for number in (1, 2):
        publisher.add(text(str(number)))  # kept, and never sent
    catch_up(far.node.feeds)
    await inbox.wait(3)
    catch_up(far.node.feeds)
    publisher.publish(text("3"))
    await inbox.wait(4)
    assert [one.payload[8:-1] for one in inbox.samples] == [b"0", b"1", b"2", b"3"]
    assert feed.missed == 0
