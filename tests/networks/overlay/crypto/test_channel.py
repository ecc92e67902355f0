"""Channels between two gateways."""

from __future__ import annotations

import random

import pytest

from ropeway.errors import SealError
from ropeway.networks.overlay.crypto.channel import Initiator, SecureChannel, peek_channel, respond
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.refusal import Refusal
from tests.networks.overlay.fleet import fleet, member

ONE, TWO = member("one"), member("two")
HERE, THERE = bytes(16), bytes(range(16))
TRUST = Trust(ONE.ca)


def pair() -> tuple[SecureChannel, SecureChannel]:
    began = Initiator(ONE, THERE)
    reply, far = respond(TWO, THERE, began.hello, TRUST)
    return began.finish(reply, TRUST), far


def refused(call: object) -> Refusal:
    with pytest.raises(SealError) as caught:
        call()  # type: ignore[operator]
    assert isinstance(caught.value.reason, Refusal)
    return caught.value.reason


def test_both_ways() -> None:
    """Each side reads what the other seals and knows who it is; nobody reads its own."""
    near, far = pair()
    assert far.open(near.seal(b"question")) == b"question"
    assert near.open(far.seal(b"answer", b"about"), b"about") == b"answer"
    assert (near.peer.name, far.peer.name) == (TWO.name, ONE.name)
    assert near.id == far.id == peek_channel(near.seal(b""))
    assert near.usable()
    packet = near.seal(b"x")
    assert refused(lambda: near.open(packet)) is Refusal.BAD_TAG


def test_packets() -> None:
    """A packet is taken once, whole and for what it is about, in any order."""
    near, far = pair()
    packets = [near.seal(b"%d" % i, b"a") for i in range(5)]
    assert far.open(packets[3], b"a") == b"3"
    assert refused(lambda: far.open(packets[3], b"a")) is Refusal.REPLAYED
    assert refused(lambda: far.open(packets[1], b"b")) is Refusal.BAD_TAG
    assert far.open(packets[1], b"a") == b"1"
    assert refused(lambda: far.open(packets[0][:20], b"a")) is Refusal.TRUNCATED
    assert refused(lambda: far.open(packets[0][:-1], b"a")) is Refusal.BAD_TAG
    other, _ = pair()
    assert refused(lambda: far.open(other.seal(b"x"))) is Refusal.WRONG_NAME
    assert refused(lambda: peek_channel(b"short")) is Refusal.TRUNCATED


def test_who_is_asked() -> None:
    """A hello is good for the gateway that it was made for, and a reply for the hello that it answers."""
    began = Initiator(ONE, THERE)
    assert refused(lambda: respond(TWO, HERE, began.hello, TRUST)) is Refusal.BAD_SIGNATURE
    reply, _ = respond(TWO, THERE, began.hello, TRUST)
    assert refused(lambda: Initiator(ONE, THERE).finish(reply, TRUST)) is Refusal.BAD_SIGNATURE
    assert refused(lambda: Initiator(ONE, HERE).finish(reply, TRUST)) is Refusal.WRONG_NAME


def test_who_may() -> None:
    """Without a good certificate of the fleet there is no channel, on either side."""
    stranger = fleet("strangers").issue("mallory")
    began = Initiator(stranger, THERE)
    assert refused(lambda: respond(TWO, THERE, began.hello, TRUST)) is Refusal.UNKNOWN_CA
    ours = Initiator(ONE, THERE)
    reply, _ = respond(stranger, THERE, ours.hello, Trust(ONE.ca))
    assert refused(lambda: ours.finish(reply, TRUST)) is Refusal.UNKNOWN_CA
    router = fleet().issue("a-router", role="router")
    assert refused(lambda: respond(TWO, THERE, Initiator(router, THERE).hello, TRUST)) is Refusal.WRONG_PURPOSE


@pytest.mark.filterwarnings("ignore:Parsed a serial number")
def test_random_bytes() -> None:
    """Whatever comes as a hello, a reply or a packet is refused with a reason."""
    rng = random.Random(3)
    near, far = pair()
    began = Initiator(ONE, THERE)
    reply, _ = respond(TWO, THERE, began.hello, TRUST)
    for _ in range(3000):
        raw = bytearray(rng.choice((began.hello, reply, near.seal(b"x"), rng.randbytes(60))))
        for at in rng.sample(range(len(raw)), rng.randrange(1, 4)):
            raw[at] ^= 1 << rng.randrange(8)
        refused(lambda raw=raw: respond(TWO, THERE, bytes(raw), TRUST))
        refused(lambda raw=raw: began.finish(bytes(raw), TRUST))
        refused(lambda raw=raw: far.open(bytes(raw)))
    assert began.finish(reply, TRUST).peer.name == TWO.name
