"""ropeway.networks.overlay.reader_proofs: when packets are proven to readers alone, and when they are signed."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import pytest

from ropeway.errors import SealError
from ropeway.limits import OVERLAY_GATEWAYS_PER_MEMBER, OVERLAY_SESSION_READERS
from ropeway.networks.overlay.crypto.seal import PacketHeader, Sealer, peek
from ropeway.networks.overlay.graph.publisher import OverlayPublisher
from ropeway.networks.overlay.packet_item import RAW, PacketItem, pack
from ropeway.networks.overlay.reader_proofs import ReaderProofs, offered
from ropeway.networks.overlay.refusal import Refusal
from ropeway.qos import QoS
from tests.networks.overlay.conftest import Site
from tests.support.inbox import Inbox
from tests.support.messages import STRING
from tests.support.messages import sample as text
from tests.support.until import until

ALICE, BOB = b"a" * 32, b"b" * 32
BEST_EFFORT = QoS(reliability="best_effort")


def gateway(number: int) -> bytes:
    return number.to_bytes(16, "big")


def secret(number: int) -> bytes:
    return number.to_bytes(32, "big")


def test_all_agree() -> None:
    """While every reader gave a secret, packets are proven to each; with nobody there is nothing to prove."""
    proofs = ReaderProofs()
    assert proofs.secrets() == ()
    proofs.granted(ALICE, gateway(1), secret(1), 0.0)
    proofs.granted(ALICE, gateway(2), secret(2), 0.0)
    proofs.granted(BOB, gateway(3), secret(3), 0.0)
    assert set(proofs.secrets()) == {secret(1), secret(2), secret(3)}
    proofs.granted(BOB, gateway(3), secret(4), 1.0)
    assert set(proofs.secrets()) == {secret(1), secret(2), secret(4)}


def test_one_wants_signatures() -> None:
    """As long as one reader wants signatures all packets are signed, though it has the certificate of another."""
    proofs = ReaderProofs()
    proofs.granted(ALICE, gateway(1), secret(1), 0.0)
    proofs.granted(ALICE, b"", b"", 0.0)
    assert proofs.secrets() == ()
    proofs.subscribed([(ALICE, gateway(1)), (ALICE, gateway(9))])
    proofs.expire(100.0)
    assert proofs.secrets() == ()  # one of its gateways may be that reader
    proofs.subscribed([])
    proofs.granted(BOB, gateway(3), secret(3), 95.0)
    proofs.expire(100.0)
    assert proofs.secrets() == (secret(3),)


def test_who_leaves() -> None:
    """A reader without a subscription is forgotten, though not before its subscription may have been heard of."""
    proofs = ReaderProofs()
    proofs.granted(ALICE, gateway(1), secret(1), 0.0)
    proofs.granted(BOB, gateway(2), secret(2), 0.0)
    proofs.expire(5.0)
    assert len(proofs.secrets()) == 2
    proofs.subscribed([(ALICE, gateway(1))])
    proofs.expire(20.0)
    assert proofs.secrets() == (secret(1),)
    proofs.lost(ALICE)
    assert proofs.secrets() == ()


def test_nobody_speaks_for_another() -> None:
    """A member that names the gateway of another replaces nothing of it."""
    proofs = ReaderProofs()
    proofs.granted(ALICE, gateway(1), secret(1), 0.0)
    proofs.granted(BOB, gateway(1), secret(2), 0.0)
    assert proofs.secrets() == (secret(1), secret(2))


def test_too_many() -> None:
    """Above a number of readers packets are signed, and one member's gateways take no more than their places."""
    proofs = ReaderProofs()
    for number in range(OVERLAY_SESSION_READERS):
        proofs.granted(ALICE, gateway(number), secret(number + 1), 0.0)
    assert len(proofs.secrets()) == OVERLAY_SESSION_READERS
    proofs.granted(ALICE, gateway(99), secret(99), 0.0)
    assert proofs.secrets() == ()
    for number in range(10 * OVERLAY_GATEWAYS_PER_MEMBER):
        proofs.granted(ALICE, gateway(number), secret(number + 1), 0.0)
    assert len(proofs._readers) == OVERLAY_GATEWAYS_PER_MEMBER


@pytest.mark.parametrize(
    "request_",
    [
        {"session": b"x" * 32},
        {"session": b"x" * 31, "by": bytes(16)},
        {"session": b"", "by": bytes(16)},
        {"session": "x" * 32, "by": bytes(16)},
        {"session": None, "by": bytes(16)},
        {"session": b"x" * 32, "by": bytes(15)},
        {"session": b"x" * 32, "by": 16},
    ],
)
def test_offers_that_are_none(request_: dict[str, Any]) -> None:
    """What is no gateway with its secret is refused, and no key is given for it."""
    with pytest.raises(SealError):
        offered(request_)


def test_offers() -> None:
    """A request without a session wants signatures, whatever else stands in it."""
    assert offered({"session": secret(1), "by": gateway(1)}) == (gateway(1), secret(1))
    assert offered({}) == offered({"by": gateway(1)}) == (b"", b"")


async def packets(publisher: OverlayPublisher, work: Callable[[], Awaitable[None]]) -> list[PacketHeader]:
    """Return the heads of what a publisher puts while ``work`` is done."""
    seen: list[PacketHeader] = []
    seal = publisher.source.seal

    def sealed(items: Sequence[PacketItem]) -> bytes:
        packet = seal(items)
        seen.append(peek(packet))
        return packet

    publisher.source.seal = sealed  # type: ignore[method-assign]
    try:
        await work()
    finally:
        publisher.source.seal = seal  # type: ignore[method-assign]
    return seen


async def test_between_members(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    """Members that agree prove messages to each other; while one reads that wants signatures all is signed, for all."""
    near, far, third = await site.join(sessions=True), await site.join(sessions=True), await site.join()
    boxes = [Inbox(), Inbox()]
    await far.create_subscription("/a", STRING, QoS(), boxes[0])
    publisher = await near.create_publisher("/a", STRING)
    await until(lambda: publisher.subscribers == 1)

    async def send(*inboxes: Inbox) -> None:
        before = [len(box.samples) for box in inboxes]
        publisher.publish(text("x"))
        for box, count in zip(inboxes, before, strict=True):
            await box.wait(count + 1)

    heads = await packets(publisher, lambda: send(boxes[0]))
    assert all(head.session and not head.signed for head in heads)
    reading = await third.create_subscription("/a", STRING, QoS(), boxes[1])
    await until(lambda: publisher.subscribers == 2)
    heads = await packets(publisher, lambda: send(*boxes))
    assert all(head.signed and not head.session for head in heads)
    await reading.close()
    await until(lambda: publisher.subscribers == 1)
    monkeypatch.setattr("ropeway.networks.overlay.reader_proofs._LEFT_S", -1.0)
    near.node.recheck()
    heads = await packets(publisher, lambda: send(boxes[0]))
    assert all(head.session for head in heads)
    assert not any(graph.node.refusals for graph in (near, far, third))


@pytest.mark.parametrize(("of_publisher", "of_reader"), [(False, True), (True, False), (False, False)])
async def test_one_side_alone(site: Site, of_publisher: bool, of_reader: bool) -> None:
    """Where the publisher, or the reader, does not agree to sessions, packets are signed."""
    near, far = await site.join(sessions=of_publisher), await site.join(sessions=of_reader)
    inbox = Inbox()
    await far.create_subscription("/a", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/a", STRING)
    await until(lambda: publisher.subscribers)

    async def send() -> None:
        publisher.publish(text("x"))
        await inbox.wait(1)

    heads = await packets(publisher, send)
    assert heads
    assert all(head.signed and not head.session for head in heads)


async def test_a_reader_forges(site: Site) -> None:
    """A member that reads, and so has the content key, makes nothing that another reader takes for the publisher's."""
    near, far, evil = [await site.join(sessions=True) for _ in range(3)]
    inbox, other = Inbox(), Inbox()
    await far.create_subscription("/a", STRING, QoS(), inbox)
    await evil.create_subscription("/a", STRING, QoS(), other)
    publisher = await near.create_publisher("/a", STRING)
    await until(lambda: publisher.subscribers == 2)
    publisher.publish(text("real"))
    await inbox.wait(1)
    await other.wait(1)
    (stream,) = next(iter(evil.node.feeds.values())).streams.values()
    forger = Sealer(publisher.advert.global_name, publisher.advert.endpoint, evil.node.identity.sign)
    grant = publisher.source._sealer.grant()
    assert stream.opener._keys[grant.current.epoch][0] == grant.current.secret  # as it was given to both
    for secrets in ((stream._secret,), ()):
        forger._use(grant.current, grant.next)
        forger.counter = 1000
        forger.prove_to(secrets)
        item = PacketItem(1001, 0, 1, bytes(16), 0, RAW, b"\0\1\0\0\7\0\0\0forged\0")
        await asyncio.to_thread(evil.node.fabric.put, 4, publisher.key, forger.seal([[pack(item)]]))
    await until(lambda: {Refusal.UNPROVEN, Refusal.BAD_SIGNATURE} <= {reason for _, reason in far.node.refusals})
    publisher.publish(text("real, too"))
    await inbox.wait(2)
    assert len(inbox.samples) == 2


async def test_a_publisher_that_lost_sight_of_a_reader(site: Site) -> None:
    """A reader to which packets are not proven any more asks again, and is proven what follows."""
    near, far, third = [await site.join(sessions=True) for _ in range(3)]
    boxes = [Inbox(), Inbox()]
    for graph, inbox in zip((far, third), boxes, strict=True):
        await graph.create_subscription("/a", STRING, BEST_EFFORT, inbox)  # nothing is brought again
    publisher = await near.create_publisher("/a", STRING, BEST_EFFORT)
    await until(lambda: publisher.subscribers == 2)
    proofs = publisher.source._proofs
    assert proofs is not None
    first = next(iter(proofs._readers))
    del proofs._readers[first]
    publisher.source.recheck(lambda _: True)
    publisher.publish(text("1"))
    await until(lambda: first in proofs._readers)
    publisher.publish(text("2"))
    for inbox in boxes:
        await until(lambda inbox=inbox: inbox.samples and b"2" in inbox.samples[-1].payload)
