"""TCPROS: connection headers, and messages framed by their lengths.

A connection begins with a header of ``name=value`` fields from either side. After that a publisher sends frames of
4 bytes length and a message; a service client sends such frames, too, and gets each answered by one byte (1: done,
0: failed) and a frame (the response, or the text of the failure).
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Mapping, Sequence
from typing import Final, Protocol, cast

from ropeway.errors import InvalidFrame

__all__ = [
    "HEADER_LIMIT_BYTES",
    "MESSAGE_LIMIT_BYTES",
    "TRACE",
    "TRACE_BYTES",
    "Receiver",
    "TcprosConnection",
    "encode_header",
    "parse_header",
    "read_frame",
    "read_header",
]

HEADER_LIMIT_BYTES: Final = 1 << 20  # it holds a whole message definition
MESSAGE_LIMIT_BYTES: Final = 512 << 20
TRACE: Final = "ropeway_trace"
"""A header field only Ropeway knows: where both sides have it with ``1``, a frame goes before each message with who
published it first (16 bytes) and its number there (8 bytes, little-endian), so that gateways notice circles."""

TRACE_BYTES: Final = 24
_FIELDS_LIMIT: Final = 128
_BUFFERED_BYTES: Final = 1 << 18  # written and not on its way: above, what follows waits where it can be dropped

_LENGTH: Final = struct.Struct("<I")


def encode_header(fields: Mapping[str, str]) -> bytes:
    """Return a connection header with its total length in front."""
    pieces: list[bytes] = []
    for name, value in fields.items():
        raw = f"{name}={value}".encode()
        pieces += (_LENGTH.pack(len(raw)), raw)
    body = b"".join(pieces)
    return _LENGTH.pack(len(body)) + body


def parse_header(body: bytes) -> dict[str, str]:
    """Parse the fields of a connection header, without its total length. Raises ``InvalidFrame``."""
    fields: dict[str, str] = {}
    position = 0
    while position < len(body):
        if len(fields) >= _FIELDS_LIMIT:
            raise InvalidFrame(f"a connection header of more than {_FIELDS_LIMIT} fields", len(body))
        if position + 4 > len(body):
            raise InvalidFrame("a connection header that ends within a length", len(body))
        (length,) = _LENGTH.unpack_from(body, position)
        position += 4
        if length > len(body) - position:
            raise InvalidFrame("a connection header with a field beyond its end", len(body))
        name, equals, value = body[position : position + length].partition(b"=")
        if not equals:
            raise InvalidFrame("a connection header with a field that has no '='", len(body))
        fields[name.decode("utf-8", "replace")] = value.decode("utf-8", "replace")
        position += length
    return fields


async def read_frame(reader: asyncio.StreamReader, limit: int = MESSAGE_LIMIT_BYTES) -> bytes:
    """Read the next frame. Raises ``InvalidFrame`` above ``limit`` bytes, ``EOFError`` where the connection ends."""
    (length,) = _LENGTH.unpack(await reader.readexactly(4))
    if length > limit:
        raise InvalidFrame(f"a frame of {length} bytes; the limit is {limit}", length)
    return await reader.readexactly(length)


async def read_header(reader: asyncio.StreamReader) -> dict[str, str]:
    """Read the connection header of the peer. Raises ``InvalidFrame``, ``EOFError``."""
    return parse_header(await read_frame(reader, HEADER_LIMIT_BYTES))


class Receiver(Protocol):
    """Handles the events of a ``TcprosConnection``."""

    def made(self, connection: TcprosConnection) -> None:
        """Note that the connection is established."""

    def header(self, connection: TcprosConnection, fields: dict[str, str]) -> None:
        """Handle the peer's header. ``InvalidFrame`` that is raised closes the connection."""

    def frames(self, connection: TcprosConnection, frames: Sequence[bytes]) -> None:
        """Take frames, oldest first."""

    def lost(self, connection: TcprosConnection) -> None:
        """Note that the connection is closed, by whichever side."""

    def writable(self, connection: TcprosConnection) -> None:
        """Send what waited: the peer reads again."""


class TcprosConnection(asyncio.Protocol):
    """A TCPROS connection, whose first frame is the header.

    ``ready`` is false while the peer does not read as fast as we write. ``reason`` tells why it was closed where we
    know better than the socket.
    """

    def __init__(self, receiver: Receiver) -> None:
        self.receiver = receiver
        self.transport: asyncio.Transport | None = None
        self.ready = True
        self.closed = asyncio.Event()
        self.reason = ""
        self._has_header = False
        self._start = b""  # of a length
        self._pieces: list[bytes] = []  # of a frame …
        self._missing = 0  # … that lacks so many bytes

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See ``asyncio.Protocol``."""
        self.transport = cast(asyncio.Transport, transport)
        self.transport.set_write_buffer_limits(_BUFFERED_BYTES)
        self.receiver.made(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """See ``asyncio.Protocol``."""
        if exc is not None and not self.reason:
            self.reason = str(exc)
        self._pieces.clear()
        self.closed.set()
        self.receiver.lost(self)

    def pause_writing(self) -> None:
        """See ``asyncio.Protocol``."""
        self.ready = False

    def resume_writing(self) -> None:
        """See ``asyncio.Protocol``."""
        self.ready = True
        self.receiver.writable(self)

    def data_received(self, data: bytes) -> None:
        """See ``asyncio.Protocol``."""
        missing = self._missing
        if len(data) < missing:
            self._pieces.append(data)
            self._missing = missing - len(data)
            return
        frames: list[bytes] = []
        try:
            if missing:
                self._pieces.append(data[:missing])
                whole = b"".join(self._pieces)  # the only copy of a big message here
                self._pieces, self._missing = [], 0
                self._frame(whole, frames)
                data = data[missing:]
            elif self._start:
                data, self._start = self._start + data, b""
            self._take(data, frames)
            if frames:
                self.receiver.frames(self, frames)
        except InvalidFrame as error:
            self.abort(error.reason)

    def _take(self, data: bytes, frames: list[bytes]) -> None:
        """Cut frames; what is left at the end is kept."""
        position, end = 0, len(data)
        while end - position >= 4:
            if self.transport is None or self.transport.is_closing():
                return
            (length,) = _LENGTH.unpack_from(data, position)
            limit = MESSAGE_LIMIT_BYTES if self._has_header else HEADER_LIMIT_BYTES
            if length > limit:
                raise InvalidFrame(f"a frame of {length} bytes; the limit is {limit}", length)
            position += 4
            if end - position < length:
                self._pieces, self._missing = [data[position:]], length - (end - position)
                return
            self._frame(data[position : position + length], frames)
            position += length
        self._start = data[position:]

    def _frame(self, frame: bytes, frames: list[bytes]) -> None:
        if self._has_header:
            frames.append(frame)
        else:
            self._has_header = True
            self.receiver.header(self, parse_header(frame))

    @property
    def waiting_bytes(self) -> int:
        """The bytes that were written and are not on their way yet."""
        return 0 if self.transport is None else self.transport.get_write_buffer_size()

    def write_header(self, fields: Mapping[str, str]) -> None:
        """Send our header."""
        self.write((encode_header(fields),))

    def write(self, pieces: Sequence[bytes | memoryview]) -> None:
        """Send bytes as they are."""
        if self.transport is not None and not self.transport.is_closing():
            self.transport.writelines(pieces)

    def refuse(self, text: str) -> None:
        """Answer the peer's header with ``error=text`` and close."""
        self.write_header({"error": text})
        self.close(text)

    def close(self, reason: str = "") -> None:
        """Close once everything written is sent."""
        self.reason = self.reason or reason
        if self.transport is not None:
            self.transport.close()

    def abort(self, reason: str = "") -> None:
        """Close now."""
        self.reason = self.reason or reason
        if self.transport is not None:
            self.transport.abort()
