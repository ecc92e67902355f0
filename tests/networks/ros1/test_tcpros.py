"""Connection headers and frames."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Sequence
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ropeway.errors import InvalidFrame
from ropeway.networks.ros1.tcpros import TcprosConnection, encode_header, parse_header, read_frame, read_header

NAMES = st.text(st.characters(codec="utf-8", exclude_characters="="), min_size=1, max_size=20)
VALUES = st.text(st.characters(codec="utf-8"), max_size=50)


class Log:
    """A receiver that writes down what it is told."""

    def __init__(self) -> None:
        self.fields: dict[str, str] = {}
        self.got: list[bytes] = []
        self.ended = False

    def made(self, connection: TcprosConnection) -> None: ...

    def header(self, connection: TcprosConnection, fields: dict[str, str]) -> None:
        self.fields = fields

    def frames(self, connection: TcprosConnection, frames: Sequence[bytes]) -> None:
        self.got.extend(frames)

    def lost(self, connection: TcprosConnection) -> None:
        self.ended = True

    def writable(self, connection: TcprosConnection) -> None: ...


class Pipe(asyncio.Transport):
    """A transport that remembers whether it was ended."""

    def __init__(self) -> None:
        super().__init__()
        self.ended = ""

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None: ...

    def is_closing(self) -> bool:
        return bool(self.ended)

    def close(self) -> None:
        self.ended = "closed"

    def abort(self) -> None:
        self.ended = "aborted"


def connected() -> tuple[TcprosConnection, Log, Pipe]:
    log, pipe = Log(), Pipe()
    connection = TcprosConnection(log)
    connection.connection_made(pipe)
    return connection, log, pipe


def frame(body: bytes) -> bytes:
    return struct.pack("<I", len(body)) + body


@settings(deadline=None)
@given(st.dictionaries(NAMES, VALUES, max_size=10))
def test_round_trip(fields: dict[str, str]) -> None:
    """A header is read as it was written, with '=' and line ends in its values."""
    raw = encode_header(fields)
    assert struct.unpack_from("<I", raw)[0] == len(raw) - 4
    assert parse_header(raw[4:]) == fields


@settings(deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes(raw: bytes) -> None:
    """Bytes that are no header are refused, and nothing else happens."""
    try:
        parse_header(raw)
    except InvalidFrame as error:
        assert "connection header" in error.reason


@settings(deadline=None)
@given(st.lists(st.binary(max_size=40), max_size=8), st.lists(st.integers(0, 400), max_size=10))
def test_any_pieces(messages: list[bytes], cuts: list[int]) -> None:
    """Frames come whole and in order, wherever the network cuts the stream."""
    stream = encode_header({"topic": "/x"}) + b"".join(map(frame, messages))
    connection, log, pipe = connected()
    for start, end in pairwise(sorted({0, len(stream), *(min(cut, len(stream)) for cut in cuts)})):
        connection.data_received(stream[start:end])
    assert (log.fields, log.got, pipe.ended) == ({"topic": "/x"}, messages, "")


def test_big_frame_in_many_pieces() -> None:
    """A message of 20 MB in many pieces is put together once."""
    connection, log, _ = connected()
    big = bytes(20 << 20)
    stream = encode_header({}) + frame(big)
    for start in range(0, len(stream), 1 << 16):
        connection.data_received(stream[start : start + (1 << 16)])
    assert log.got == [big]


@pytest.mark.parametrize(
    "stream",
    [
        struct.pack("<I", 2 << 20),
        frame(struct.pack("<I", 100)),
        frame(frame(b"no equals sign")),
        encode_header({"topic": "/x"}) + struct.pack("<I", 2**31),
    ],
)
def test_ends_bad_streams(stream: bytes) -> None:
    """A stream that cannot be understood ends the connection, with the reason."""
    connection, log, pipe = connected()
    connection.data_received(stream)
    assert pipe.ended == "aborted"
    assert connection.reason
    assert not log.got


async def test_streams() -> None:
    """Headers and frames are read from a stream, within their limits."""
    reader = asyncio.StreamReader()
    reader.feed_data(encode_header({"a": "b"}) + frame(b"xyz") + frame(b"long"))
    assert await read_header(reader) == {"a": "b"}
    assert await read_frame(reader) == b"xyz"
    with pytest.raises(InvalidFrame, match="the limit is 3"):
        await read_frame(reader, 3)
