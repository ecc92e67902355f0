"""Messages inside packets."""

from __future__ import annotations

import contextlib
import struct

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import SealError
from ropeway.networks.overlay.packet_item import (
    RAW,
    RELAYED,
    ZSTD,
    PacketItem,
    frame,
    pack,
    read_item,
    read_items,
    read_packet,
    unpack,
)
from ropeway.networks.overlay.refusal import Refusal
from tests.networks.overlay.hostile import bomb, peak_bytes

MIB = 1 << 20


def packed(payload: bytes, encoding: int = ZSTD) -> bytes:
    return pack(PacketItem(1, 0, 1, b"o" * 16, 0, encoding, payload))


@given(st.integers(0, 2**64 - 1), st.integers(-(2**63), 2**63 - 1), st.binary(max_size=50))
def test_round_trip(number: int, stamp_ns: int, payload: bytes) -> None:
    """What is packed is unpacked, every field as it was."""
    item = PacketItem(number, stamp_ns, 2**64 - 1, bytes(range(16)), RELAYED, ZSTD, payload)
    assert unpack(pack(item)) == item
    assert unpack(memoryview(pack(item))) == item


def test_layout() -> None:
    """The bytes are those of the table in the module."""
    raw = pack(PacketItem(1, 2, 3, b"o" * 16, 4, 5, b"data"))
    assert raw == bytes([0] * 7 + [1] + [0] * 7 + [2] + [0] * 7 + [3]) + b"o" * 16 + b"\x04\x05data"


def test_too_short() -> None:
    """Fewer bytes than a head has are refused."""
    with pytest.raises(SealError) as caught:
        unpack(bytes(41))
    assert caught.value.reason is Refusal.TRUNCATED


def test_a_message_is_no_larger_than_the_limit() -> None:
    """A message that would be above the limit is refused, compressed or not, before memory is taken for it."""
    whole = bytes(MIB)
    assert read_item(packed(whole, RAW), MIB).payload == whole
    assert read_item(packed(bomb(MIB)), MIB).payload == whole
    for raw in (packed(bytes(MIB + 1), RAW), packed(bomb(MIB + 1)), packed(bomb(256 * MIB))):
        with pytest.raises(SealError) as caught:
            read_item(raw, MIB)
        assert caught.value.reason is Refusal.TOO_BIG
    assert peak_bytes(lambda: read_item(packed(bomb(256 * MIB)), MIB)) < 4 * MIB


def test_a_packet_has_a_budget() -> None:
    """All messages of a packet together are held to a budget; a packet of bombs is refused with its second one."""
    small = packed(b"x" * 100, RAW)
    assert len(read_items([small] * 100 + [packed(bomb(MIB))], MIB, 20_000)) == 101
    bombs = [packed(bomb(MIB)) for _ in range(30)]
    with pytest.raises(SealError) as caught:
        read_items(bombs, MIB, 1000)
    assert caught.value.reason is Refusal.TOO_BIG
    assert peak_bytes(lambda: read_items(bombs, MIB, 1000)) < 4 * MIB


def test_an_unknown_encoding() -> None:
    """A message in an encoding that nobody here knows is refused, and not taken for a plain one."""
    with pytest.raises(SealError) as caught:
        unpack(packed(b"data", 2))
    assert caught.value.reason is Refusal.MALFORMED


@given(st.binary(max_size=200), st.integers(0, 5))
def test_whatever_comes_is_read_or_refused(body: bytes, kind: int) -> None:
    """Any bytes are a message, or a SealError; no other exception."""
    for raw in (body, packed(body), packed(bytes([kind]) + body)):
        with contextlib.suppress(SealError):
            read_item(raw)


def test_a_filter_that_divides_by_zero() -> None:
    """A body whose columns are as wide as its rows are long is refused as any other malformed one."""
    plane = zstandard.ZstdCompressor().compress(bytes(300))
    planes = b"".join(struct.pack("<I", len(plane)) + plane for _ in range(2))
    with pytest.raises(SealError) as caught:
        read_item(packed(struct.pack("<BBBxIIII", 3, 4, 2, 0, 0, 1200, 300) + planes))
    assert caught.value.reason is Refusal.MALFORMED


def spans(raws: list[bytes]) -> tuple[bytes, list[tuple[int, int]]]:
    ends = [sum(map(len, raws[: count + 1])) for count in range(len(raws))]
    return b"".join(raws), [(end - len(raw), end) for raw, end in zip(raws, ends, strict=True)]


@given(st.lists(st.tuples(st.binary(max_size=60), st.sampled_from((RAW, ZSTD, 9))), max_size=5), st.integers(0, 80))
def test_packets_are_read_as_messages_are(bodies: list[tuple[bytes, int]], limit: int) -> None:
    """Whatever stands in a packet, it is read, or refused, as its messages are one by one."""
    raws = [packed(body, encoding) for body, encoding in bodies] + [b"short"][: limit % 2]
    found: list[object] = []
    for read in (lambda: read_items(raws, limit), lambda: read_packet(*spans(raws), limit)):
        try:
            found.append(read())
        except SealError as error:
            found.append(error.reason)
    assert found[0] == found[1]


def test_a_packet_is_held_to_its_budget() -> None:
    """The messages of a packet together are held to the same budget, wherever they stand."""
    raws = [packed(bytes(MIB), RAW)] * 3
    with pytest.raises(SealError) as caught:
        read_packet(*spans(raws), MIB)
    assert caught.value.reason is Refusal.TOO_BIG
    assert len(read_packet(*spans(raws[:2]), MIB)) == 2


def test_frames() -> None:
    """Messages are framed by their lengths, in the layout of one alone."""
    items = [PacketItem(n, 2, 3, b"o" * 16, 0, RAW, b"x" * n) for n in range(3)]
    assert b"".join(frame(items)) == b"".join(struct.pack(">I", len(pack(item))) + pack(item) for item in items)
