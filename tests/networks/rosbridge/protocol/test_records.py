"""ropeway.networks.rosbridge.protocol.records."""

from __future__ import annotations

import os
import tracemalloc

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ropeway.errors import InvalidFrame, MessageTooBig, WireError
from ropeway.limits import UNFINISHED_MESSAGE_S, UNFINISHED_MESSAGES
from ropeway.networks.rosbridge.protocol.records import HEADER_BYTES, Arrival, RecordReader, RecordWriter


def reader(limit: int = 1 << 20, refused: list[tuple[int, WireError]] | None = None) -> RecordReader:
    return RecordReader(limit, lambda channel, error: refused.append((channel, error)) if refused is not None else None)


def send(writer: RecordWriter, *bodies: bytes, channel: int = 1, origin: bytes = bytes(16)) -> bytes:
    out: list[bytes] = []
    for seq, body in enumerate(bodies):
        writer.message(out, channel, 3, body, origin, seq, 7)
    return b"".join(out)


def test_many_in_one_frame() -> None:
    """Messages of one frame come out whole, in order, with all that was said of them."""
    writer = RecordWriter()
    got = reader().read(send(writer, b"a", b"", b"ccc"))
    assert got == [Arrival(1, 3, body, bytes(16), seq, 7) for seq, body in enumerate([b"a", b"", b"ccc"])]


def test_origins_declared_once() -> None:
    """An origin's 16 bytes cross once; afterwards a number stands for them."""
    writer = RecordWriter()
    first, second = send(writer, b"x", origin=b"o" * 16), send(writer, b"x", origin=b"o" * 16)
    assert len(first) - len(second) == HEADER_BYTES + 16
    read = reader()
    assert read.read(first)[0].origin == read.read(second)[0].origin == b"o" * 16


def test_many_origins() -> None:
    """More origins than the table holds still arrive right."""
    writer, read = RecordWriter(), reader()
    for i in range(10_000):
        origin = (i % 5000).to_bytes(16, "big")
        assert read.read(send(writer, b"x", origin=origin))[0].origin == origin


def test_parts_interleave() -> None:
    """Parts of different channels may interleave; each message is joined from its own."""
    writer, read = RecordWriter(), reader()
    a, b = os.urandom(1000), os.urandom(500)
    out: list[bytes] = []
    writer.first(out, 1, 3, len(a), a[:400], b"a" * 16, 1, 1)
    writer.first(out, 2, 3, len(b), b[:100], b"b" * 16, 2, 2, relayed=True)
    writer.more(out, 1, a[400:900])
    writer.more(out, 2, memoryview(b)[100:])
    got = read.read(b"".join(out))
    assert got == [Arrival(2, 3, b, b"b" * 16, 2, 2, True)]
    out = []
    writer.more(out, 1, a[900:])
    assert read.read(b"".join(out))[0].body == a


def test_too_big() -> None:
    """A message above the limit is refused once, its parts are skipped, and the next one arrives."""
    refused: list[tuple[int, WireError]] = []
    writer, read = RecordWriter(), reader(1000, refused)
    out: list[bytes] = []
    writer.first(out, 9, 3, 5000, b"x" * 500, bytes(16), 1, 1)
    writer.more(out, 9, b"x" * 4500)
    writer.message(out, 9, 3, b"y" * 2000, bytes(16), 2, 1)
    writer.message(out, 9, 3, b"fits", bytes(16), 3, 1)
    assert [a.body for a in read.read(b"".join(out))] == [b"fits"]
    sizes = [(channel, error.size_bytes) for channel, error in refused if isinstance(error, MessageTooBig)]
    assert sizes == [(9, 5000), (9, 2000)]
    assert len(refused) == 2


def first(channel: int, total: int, part: bytes = b"x") -> bytes:
    """The frame that begins a message."""
    out: list[bytes] = []
    RecordWriter().first(out, channel, 3, total, part, bytes(16), 1, 1)
    return b"".join(out)


def more(channel: int, part: bytes) -> bytes:
    """A frame that goes on with a message."""
    out: list[bytes] = []
    RecordWriter().more(out, channel, part)
    return b"".join(out)


def test_unfinished_are_bounded() -> None:
    """Of messages that never end, no more than twice the limit of one is kept."""
    refused: list[tuple[int, WireError]] = []
    read = reader(1000, refused)
    for channel in range(1, 6):
        read.read(first(channel, 900, bytes(800)))
    assert [channel for channel, _ in refused] == [3, 4, 5]
    assert read.pending_bytes == 1600


def test_nothing_is_reserved() -> None:
    """A message takes what came of it, and not what it announced."""
    limit = 64 << 20
    read = reader(limit)
    tracemalloc.start()
    try:
        for channel in range(1, 1 + UNFINISHED_MESSAGES):
            read.read(first(channel, limit))
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < 100 * UNFINISHED_MESSAGES + (1 << 20)
    assert read.pending_bytes == UNFINISHED_MESSAGES


def test_too_many_unfinished() -> None:
    """No more than so many messages are unfinished at a time; those that are go on."""
    refused: list[tuple[int, WireError]] = []
    read = reader(1000, refused)
    for channel in range(1, 3 + UNFINISHED_MESSAGES):
        read.read(first(channel, 2))
    assert [channel for channel, _ in refused] == [UNFINISHED_MESSAGES + 1, UNFINISHED_MESSAGES + 2]
    assert [arrival.body for arrival in read.read(more(1, b"y"))] == [b"xy"]


def test_nothing_more_comes() -> None:
    """A message of which nothing more comes is dropped after a while; one that goes on slowly is not."""
    now, refused = [0.0], []
    read = RecordReader(1000, lambda channel, error: refused.append(channel), clock=lambda: now[0])
    read.read(first(1, 10))
    read.read(first(2, 3))
    now[0] = UNFINISHED_MESSAGE_S
    read.read(more(2, b"y"))
    now[0] += 1
    read.expire()
    assert refused == [1]
    assert read.pending_bytes == 2
    assert read.read(more(1, b"y")) == []
    assert [arrival.body for arrival in read.read(more(2, b"z"))] == [b"xyz"]
    assert read.pending_bytes == 0


def test_channels_that_nobody_has() -> None:
    """Of a message in parts on a channel that nobody has, nothing is kept."""
    refused: list[int] = []
    read = RecordReader(1000, lambda channel, error: refused.append(channel), lambda channel: channel == 2)
    assert read.read(first(1, 3, b"ab") + more(1, b"c")) == []
    assert refused == [1]
    assert [arrival.body for arrival in read.read(first(2, 3, b"ab") + more(2, b"c"))] == [b"abc"]
    read.read(first(2, 3))
    read.clear()
    assert read.pending_bytes == 0


@pytest.mark.parametrize(
    "data",
    [
        b"\x01",
        send(RecordWriter(), b"abc")[:-1],
        b"\x09" + bytes(27),
        send(RecordWriter(), b"abc")[HEADER_BYTES + 16 :],
        b"\x04\0\0\0\0\0\0\0\x03\0\0\0" + bytes(16) + b"abc",
    ],
    ids=["short header", "cut body", "unknown kind", "undeclared origin", "short origin"],
)
def test_malformed(data: bytes) -> None:
    """A malformed record is an InvalidFrame."""
    with pytest.raises(InvalidFrame):
        reader().read(data)


@settings(max_examples=300)
@given(st.lists(st.binary(max_size=60), max_size=5), st.data())
def test_hostile_bytes(frames: list[bytes], data: st.DataObject) -> None:
    """Whatever comes, the only error is InvalidFrame, and a good frame is read afterwards."""
    read = reader()
    good = send(RecordWriter(), b"first", b"second")
    position = data.draw(st.integers(0, len(good) - 1))
    damaged = bytearray(good)
    damaged[position] ^= data.draw(st.integers(1, 255))
    for frame in [*frames, bytes(damaged)]:
        try:
            read.read(frame)
        except InvalidFrame:
            continue
    assert [a.body for a in read.read(good)] == [b"first", b"second"]
