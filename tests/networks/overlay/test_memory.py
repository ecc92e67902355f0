"""What members send costs a member no more than its limits, and nothing once they have left."""

from __future__ import annotations

import asyncio
import gc
import tracemalloc
from collections.abc import AsyncIterator, Callable, Iterator
from functools import partial

import pytest

from ropeway import aio
from ropeway.networks.overlay import rpc
from ropeway.networks.overlay.crypto.channel import Initiator
from ropeway.networks.overlay.fabric import Fabric
from ropeway.networks.overlay.feed import Feed
from ropeway.networks.overlay.follower import Follower
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.held_bytes import HeldBytes
from ropeway.networks.overlay.node import OverlayNode
from ropeway.networks.overlay.packet_item import RAW, ZSTD, PacketItem
from ropeway.networks.overlay.publisher_stream import PublisherStream
from ropeway.networks.overlay.refusal import Refusal
from ropeway.qos import QoS
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.fleet import member
from tests.networks.overlay.hostile import bomb
from tests.networks.overlay.test_attacks import refusals
from tests.support.inbox import Inbox
from tests.support.messages import STRING
from tests.support.messages import sample as text
from tests.support.until import PATIENCE_S, until

MIB = 1 << 20


@pytest.fixture
async def pair(site: Site) -> AsyncIterator[tuple[OverlayGraph, OverlayGraph]]:
    yield await site.join(), await site.join(max_message_bytes=MIB)


async def put_until(graph: OverlayGraph, key: str, make: Callable[[], bytes], condition: Callable[[], bool]) -> None:
    """Put packet after packet: the way to a reader, and its key, may be there a moment after the reader."""
    async with aio.timeout(PATIENCE_S):
        while not condition():
            await asyncio.to_thread(graph.node.fabric.put, 4, key, make())
            await asyncio.sleep(0.05)


@pytest.fixture
def traced() -> Iterator[None]:
    """Count memory while the graphs live, whose threads may crash Python if that ends before them."""
    tracemalloc.start()
    yield
    tracemalloc.stop()


async def test_a_packet_of_bombs(traced: None, pair: tuple[OverlayGraph, OverlayGraph]) -> None:
    """A packet of a few kilobytes that would be gigabytes costs its reader a message, is refused, and others follow."""
    near, far = pair
    inbox = Inbox()
    await far.create_subscription("/x", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/x", STRING)
    await until(lambda: publisher.subscribers)
    items = [PacketItem(n, 0, 1, b"o" * 16, 0, ZSTD, bomb(1024 * MIB)) for n in range(1, 5)]
    before = tracemalloc.get_traced_memory()[0]
    tracemalloc.reset_peak()
    make = partial(publisher.source.seal, items)
    await put_until(near, publisher.key, make, lambda: Refusal.TOO_BIG in refusals(far))
    assert tracemalloc.get_traced_memory()[1] - before < 8 * MIB
    publisher.publish(text("good"))
    await inbox.wait(1, 30)


async def test_many_messages_in_one_packet(pair: tuple[OverlayGraph, OverlayGraph]) -> None:
    """A packet of more messages than a sender puts in one is refused unread."""
    near, far = pair
    await far.create_subscription("/x", STRING, QoS(), lambda _: None)
    publisher = await near.create_publisher("/x", STRING)
    await until(lambda: publisher.subscribers)
    items = [PacketItem(n, 0, 1, b"o" * 16, 0, RAW, b"") for n in range(1, 60_000)]
    await put_until(
        near, publisher.key, partial(publisher.source.seal, items), lambda: Refusal.TOO_BIG in refusals(far)
    )


async def test_packets_without_a_key(pair: tuple[OverlayGraph, OverlayGraph]) -> None:
    """Packets whose key nobody has wait within the budget of the node, and are let go of with their publisher."""
    near, far = pair
    far.node.held.limit_bytes = 3 * MIB
    await far.create_subscription("/x", STRING, QoS(), lambda _: None)
    publisher = await near.create_publisher("/x", STRING)
    await until(lambda: publisher.subscribers)
    junk = bytearray(publisher.source.seal([PacketItem(1, 0, 1, b"o" * 16, 0, RAW, bytes(MIB - 1000))]))
    junk[4:8] = b"\xff\xff\xff\xff"  # an epoch that was never granted
    await put_until(near, publisher.key, lambda: bytes(junk), lambda: Refusal.NO_KEY in refusals(far))
    assert far.node.held.bytes <= 3 * MIB
    await publisher.close()
    await until(lambda: far.node.held.bytes == 0)


def test_messages_behind_a_gap() -> None:
    """What waits for a message that is missing is taken from the budget, and given on where that is used up."""
    held = HeldBytes(10_000)
    follower = Follower(reliable=True, history=False, start=0, held=held)
    assert follower.arrived([PacketItem(2, 0, 2, b"", 0, RAW, bytes(5000))]) == []
    assert 5000 <= held.bytes <= 10_000
    given = follower.arrived([PacketItem(3, 0, 3, b"", 0, RAW, bytes(6000))])
    assert [item.number for item in given] == [2, 3]
    assert (follower.lost, held.bytes) == (1, 0)
    follower.arrived([PacketItem(5, 0, 5, b"", 0, RAW, bytes(5000))])
    follower.forget()
    assert held.bytes == 0


async def test_channels_of_one_member(pair: tuple[OverlayGraph, OverlayGraph], monkeypatch: pytest.MonkeyPatch) -> None:
    """However often a member greets, a gateway keeps so many channels of it, the newest, and answers on them."""
    monkeypatch.setattr(rpc, "OVERLAY_CHANNELS_PER_MEMBER", 3)
    near, far = pair
    for _ in range(8):
        hello = Initiator(near.node.identity, far.node.gateway).hello
        assert (await near.node.fabric.ask(rpc.key_of(far.node.gateway), b"\x01" + hello, 5.0))[0][:1] == b"\x01"
    assert len(far.node.rpc._inbound) == 3
    assert await near.node.ping(far.node.gateway, 5.0) > 0


async def test_everybody_has_left(site: Site) -> None:
    """After members have come, published, read, called and left again, nothing of theirs is held."""
    graph = await site.join()
    await graph.create_subscription("/x", STRING, None, lambda _: None)
    identities = [member("guest") for _ in range(6)]

    async def visits(count: int) -> None:
        guests = [OverlayGraph(OverlayNode(who, routers=[site.endpoint], listen=())) for who in identities[:count]]
        for guest in guests:
            await guest.open()
        for guest in guests:
            publisher = await guest.create_publisher("/x", STRING)
            await until(lambda: publisher.subscribers, 30)  # noqa: B023
            publisher.publish(text("hello"))
        for guest in guests:
            await guest.close()
        await until(lambda: not graph.node.membership.gateways())

    def census() -> dict[int, object]:
        gc.collect()
        kinds = {PublisherStream, Follower, Feed, Fabric, OverlayGraph}
        return {id(found): found for found in gc.get_objects() if type(found) in kinds}

    before = census()  # which also keeps what others have left until the end
    await visits(6)
    await until(lambda: census().keys() <= before.keys())  # a thread of the network may have the last for a moment
    assert graph.node.held.bytes == 0
    assert not graph.node.rib.all("publisher")
    assert not graph.node.rpc._channels
