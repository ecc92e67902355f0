"""Sealed packets."""

from __future__ import annotations

import os
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ropeway.errors import SealError
from ropeway.networks.overlay.crypto.seal import ContentKey, Grant, Opener, Sealer, peek
from ropeway.networks.overlay.refusal import Refusal
from tests.networks.overlay.fleet import fleet, member

NAME, PUBLISHER = bytes(range(32)), bytes(range(16))
OWNER = member("publisher")


def sealer(name: bytes = NAME, publisher: bytes = PUBLISHER) -> Sealer:
    return Sealer(name, publisher, OWNER.sign)


def opener(grant: Grant | None = None, name: bytes = NAME, publisher: bytes = PUBLISHER) -> Opener:
    made = Opener(name, publisher, OWNER.certificate.verify_signature)
    if grant is not None:
        made.add(grant)
    return made


def reason(opener: Opener, packet: bytes) -> Refusal:
    with pytest.raises(SealError) as caught:
        opener.open(packet)
    assert isinstance(caught.value.reason, Refusal)
    return caught.value.reason


@pytest.mark.parametrize("sizes", [[0], [5], [1000] * 64, [305_000], [6_000_000]])
def test_round_trip(sizes: list[int]) -> None:
    """What is sealed is opened, byte for byte, one message or a batch."""
    source = sealer()
    reader = opener(source.grant())
    items = [os.urandom(size) for size in sizes]
    packet = source.seal([[item] for item in items])
    assert reader.knows(packet)
    opened = reader.open(packet)
    assert (opened.first, [bytes(i) for i in opened.items], opened.epoch) == (1, items, source.epoch)
    assert source.counter == len(sizes)
    assert peek(packet)[:3] == (source.epoch, 1, len(sizes))


def test_nothing_shows() -> None:
    """A packet holds neither the payload nor the name."""
    packet = sealer().seal([[b"the secret payload"]])
    assert b"secret" not in packet
    assert NAME not in packet


def test_rsa() -> None:
    """In a fleet of RSA keys messages are signed by RSASSA-PSS, and refused all the same when altered."""
    owner = fleet("rsa-seal", "rsa").issue("robot")
    source = Sealer(NAME, PUBLISHER, owner.sign)
    reader = Opener(NAME, PUBLISHER, owner.certificate.verify_signature)
    reader.add(source.grant())
    packet = source.seal([[b"data"]])
    assert reader.open(packet).items == [b"data"]
    other = bytearray(source.seal([[b"data"]]))
    other[30] ^= 1
    assert reason(reader, bytes(other)) is Refusal.BAD_SIGNATURE


def test_replays_and_order() -> None:
    """Packets may come in another order, each once; a replay is told from what is too old."""
    source = sealer()
    reader = opener(source.grant())
    packets = [source.seal([[b"%d" % i]]) for i in range(10)]
    random.Random(1).shuffle(packets)
    assert sorted(reader.open(packet).first for packet in packets) == list(range(1, 11))
    for packet in packets:
        assert reason(reader, packet) is Refusal.REPLAYED
    later = opener(source.grant())
    assert reason(later, packets[0]) is Refusal.TOO_OLD


def test_other_name_or_publisher() -> None:
    """A packet that is put under another name, or as another publisher's, is refused."""
    source = sealer()
    packet, grant = source.seal([[b"x"]]), Grant(*_keys(source), 0)
    assert reason(opener(grant, name=bytes(32)), packet) is Refusal.BAD_SIGNATURE
    assert reason(opener(grant, publisher=bytes(16)), packet) is Refusal.BAD_SIGNATURE


def _keys(source: Sealer) -> tuple[ContentKey, ContentKey]:
    grant = source.grant()
    return grant.current, grant.next


def test_reader_cannot_forge() -> None:
    """A member that was given the key but is not the publisher cannot make a packet."""
    source = sealer()
    reader = opener(source.grant())
    forger = Sealer(NAME, PUBLISHER, member("reader").sign)
    forger._use(*_keys(source))
    assert reason(reader, forger.seal([[b"forged"]])) is Refusal.BAD_SIGNATURE
    unsigned = Sealer(NAME, PUBLISHER, None)
    unsigned._use(*_keys(source))
    assert reason(reader, unsigned.seal([[b"forged"]])) is Refusal.BAD_SIGNATURE
    assert reader.open(source.seal([[b"real"]])).items == [b"real"]


def test_refused_packets_change_nothing() -> None:
    """What is refused does not move the window: the real packet of that number is still taken."""
    source = sealer()
    reader = opener(source.grant())
    packet = source.seal([[b"x"]])
    for at in range(0, len(packet), 7):
        altered = bytearray(packet)
        altered[at] ^= 0x40
        reason(reader, bytes(altered))
    assert reader.open(packet).items == [b"x"]


def test_rotation() -> None:
    """The next key is known before it is used; the one after it has to be asked for, and the old one still opens."""
    source = sealer()
    reader = opener(source.grant())
    first = source.seal([[b"1"]])
    source.rotate()
    second = source.seal([[b"2"]])
    assert reader.open(second).items == [b"2"]
    assert reader.open(first).items == [b"1"]
    source.rotate()
    third = source.seal([[b"3"]])
    assert not reader.knows(third)
    assert reason(reader, third) is Refusal.NO_KEY
    reader.add(source.grant())
    assert reader.open(third).items == [b"3"]


def test_renewal() -> None:
    """After somebody lost the right neither of the keys it had opens anything."""
    source = sealer()
    reader = opener(source.grant())
    source.renew()
    assert reason(reader, source.seal([[b"x"]])) is Refusal.NO_KEY


def test_keys_are_few() -> None:
    """A reader keeps the keys around the current one, and no others."""
    source = sealer()
    reader = opener(source.grant())
    first = source.seal([[b"x"]])
    for _ in range(5):
        source.rotate()
        reader.add(source.grant())
    assert reason(reader, first) is Refusal.NO_KEY


def test_grants() -> None:
    """A grant is read as it was written, and anything else is refused."""
    grant = sealer().grant()
    assert Grant.from_cbor(grant.to_cbor()) == grant
    for raw in (b"", b"\x80", b"\x83\x01\x02\x03", grant.to_cbor()[:-1], b"\x83\x82\x01\x40\x82\x02\x40\x00"):
        with pytest.raises(SealError):
            Grant.from_cbor(raw)


@settings(max_examples=400)
@given(st.data())
def test_every_bit_counts(data: st.DataObject) -> None:
    """A packet with any bit flipped, or cut anywhere, is refused with a reason."""
    source = sealer()
    reader = opener(source.grant())
    packet = source.seal([[b"some ", b"message"], [b"another"]])
    if data.draw(st.booleans()):
        packet = packet[: data.draw(st.integers(0, len(packet) - 1))]
    else:
        raw = bytearray(packet)
        raw[data.draw(st.integers(0, len(raw) - 1))] ^= 1 << data.draw(st.integers(0, 7))
        packet = bytes(raw)
    reason(reader, packet)


def test_random_bytes() -> None:
    """Whatever comes, it is refused with a reason."""
    reader = opener(sealer().grant())
    rng = random.Random(2)
    for _ in range(20_000):
        raw = rng.randbytes(rng.randrange(120))
        if rng.random() < 0.5:
            raw = b"\x52\x01\x01\x00" + raw
        reason(reader, raw)
