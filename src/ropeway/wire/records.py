"""Binary records of the ``ropeway.1`` subprotocol: many messages in one WebSocket frame, big ones in parts.

A frame is one or more records, each a 28-byte little-endian header and a body::

    u8 kind | u8 encoding | u16 channel | u16 origin | u16 flags | u32 body length | u64 seq | i64 stamp_ns

* ``MESSAGE``: a whole message; the body is encoded as ``encoding`` says (an index into ``codec.ENCODINGS``).
* ``FIRST``: the beginning of a message in parts; the body is the total length (u32) and the first part.
* ``MORE``: the next part of the message begun on this channel. Parts of different channels may interleave.
* ``ORIGIN``: 16 bytes that ``origin`` stands for from now on in this direction of the connection.

A channel is a number that the client gave a topic in ``advertise`` or ``subscribe``. ``stamp_ns`` is the time at
which the sending gateway received the message, by its own clock. Flag 1 says that ``seq`` is the first publisher's
but ``origin`` is not: another gateway's publisher stood between them on a network that carries no origin.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from collections.abc import Callable
from typing import Final, NamedTuple

from ropeway.errors import InvalidFrame, MessageTooBig

__all__ = ["HEADER_BYTES", "Arrival", "RecordReader", "RecordWriter"]


MESSAGE: Final = 1
FIRST: Final = 2
MORE: Final = 3
ORIGIN: Final = 4

_HEADER: Final = struct.Struct("<BBHHHIQq")
_TOTAL: Final = struct.Struct("<I")
HEADER_BYTES: Final = _HEADER.size
_ORIGINS: Final = 4096  # remembered per direction; an older one is declared again when it comes back


class Arrival(NamedTuple):
    """A whole message as it came: ``body`` is still encoded."""

    channel: int
    encoding: int
    body: bytes
    origin: bytes
    seq: int
    stamp_ns: int
    relayed: bool = False


class RecordWriter:
    """Builds records for one direction of a connection."""

    def __init__(self) -> None:
        self._origins: OrderedDict[bytes, int] = OrderedDict()

    def _origin(self, origin: bytes, out: list[bytes]) -> int:
        index = self._origins.get(origin)
        if index is not None:
            return index
        if len(self._origins) < _ORIGINS:
            index = len(self._origins)
        else:
            _, index = self._origins.popitem(last=False)
        self._origins[origin] = index
        out.append(_HEADER.pack(ORIGIN, 0, 0, index, 0, 16, 0, 0))
        out.append(origin)
        return index

    def message(
        self,
        out: list[bytes],
        channel: int,
        encoding: int,
        body: bytes,
        origin: bytes,
        seq: int,
        stamp_ns: int,
        relayed: bool = False,
    ) -> None:
        """Append one whole message."""
        index = self._origins.get(origin)
        if index is None:
            index = self._origin(origin, out)
        out.append(_HEADER.pack(MESSAGE, encoding, channel, index, relayed, len(body), seq, stamp_ns))
        out.append(body)

    def first(
        self,
        out: list[bytes],
        channel: int,
        encoding: int,
        total: int,
        part: bytes | memoryview,
        origin: bytes,
        seq: int,
        stamp_ns: int,
        relayed: bool = False,
    ) -> None:
        """Append the first part of a message of ``total`` bytes."""
        index = self._origin(origin, out)
        out.append(_HEADER.pack(FIRST, encoding, channel, index, relayed, len(part) + 4, seq, stamp_ns))
        out.append(_TOTAL.pack(total))
        out.append(part)  # type: ignore[arg-type]  # bytes.join takes any buffer

    def more(self, out: list[bytes], channel: int, part: bytes | memoryview) -> None:
        """Append the next part of the message begun on ``channel``."""
        out.append(_HEADER.pack(MORE, 0, channel, 0, 0, len(part), 0, 0))
        out.append(part)  # type: ignore[arg-type]


class _Partial:
    __slots__ = ("buffer", "encoding", "filled", "origin", "relayed", "seq", "stamp_ns")

    def __init__(self, encoding: int, total: int, origin: bytes, seq: int, stamp_ns: int, relayed: bool) -> None:
        self.encoding, self.origin, self.seq, self.stamp_ns, self.relayed = encoding, origin, seq, stamp_ns, relayed
        self.buffer = bytearray(total)
        self.filled = 0


class RecordReader:
    """Reads the records of one direction of a connection.

    ``limit_bytes`` bounds a single message and the sum of all unfinished ones. A message above it is reported to
    ``on_refused`` once and its parts are skipped; the connection goes on.
    """

    def __init__(self, limit_bytes: int, on_refused: Callable[[int, MessageTooBig], None]) -> None:
        self.limit_bytes = limit_bytes
        self._on_refused = on_refused
        self._origins: dict[int, bytes] = {}
        self._partials: dict[int, _Partial] = {}
        self._partial_bytes = 0

    def read(self, data: bytes | memoryview) -> list[Arrival]:
        """The messages that this frame completes.

        Raises ``InvalidFrame`` at a malformed record; what the frame completed before it is lost with it.
        """
        view = memoryview(data)
        size = len(view)
        at = 0
        done: list[Arrival] = []
        origins = self._origins
        unpack = _HEADER.unpack_from
        while at < size:
            if size - at < HEADER_BYTES:
                raise InvalidFrame(f"{size - at} bytes are left, a record header has {HEADER_BYTES}", size)
            kind, encoding, channel, index, flags, length, seq, stamp_ns = unpack(view, at)
            at += HEADER_BYTES
            end = at + length
            if end > size:
                raise InvalidFrame(f"a record of {length} bytes is cut after {size - at}", size)
            if kind == MESSAGE:
                origin = origins.get(index)
                if origin is None:
                    raise InvalidFrame(f"origin {index} was never declared", size)
                if length > self.limit_bytes:
                    self._on_refused(channel, MessageTooBig(length, self.limit_bytes))
                else:
                    done.append(Arrival(channel, encoding, bytes(view[at:end]), origin, seq, stamp_ns, bool(flags & 1)))
            elif kind == MORE:
                self._more(channel, view[at:end], done)
            elif kind == FIRST:
                origin = origins.get(index)
                if origin is None or length < 4:
                    raise InvalidFrame(f"origin {index} was never declared, or the part has no length", size)
                self._first(channel, encoding, view[at:end], origin, seq, stamp_ns, bool(flags & 1), done)
            elif kind == ORIGIN:
                if length != 16 or index >= _ORIGINS:
                    raise InvalidFrame("an origin has 16 bytes and a number below 4096", size)
                origins[index] = bytes(view[at:end])
            else:
                raise InvalidFrame(f"records of kind {kind} are unknown", size)
            at = end
        return done

    def forget(self, channel: int) -> None:
        """Drop the unfinished message of a channel."""
        partial = self._partials.pop(channel, None)
        if partial is not None:
            self._partial_bytes -= len(partial.buffer)

    def _first(
        self,
        channel: int,
        encoding: int,
        body: memoryview,
        origin: bytes,
        seq: int,
        stamp_ns: int,
        relayed: bool,
        done: list[Arrival],
    ) -> None:
        self.forget(channel)
        (total,) = _TOTAL.unpack_from(body)
        if total > self.limit_bytes or self._partial_bytes + total > 2 * self.limit_bytes:
            self._on_refused(channel, MessageTooBig(total, self.limit_bytes))
            return
        part = len(body) - 4
        if part > total:
            raise InvalidFrame(f"a first part of {part} bytes is longer than its message of {total}")
        if part == total:
            done.append(Arrival(channel, encoding, bytes(body[4:]), origin, seq, stamp_ns, relayed))
            return
        partial = _Partial(encoding, total, origin, seq, stamp_ns, relayed)
        self._partials[channel] = partial
        self._partial_bytes += total
        partial.buffer[:part] = body[4:]
        partial.filled = part

    def _more(self, channel: int, body: memoryview, done: list[Arrival]) -> None:
        partial = self._partials.get(channel)
        if partial is None:
            return  # refused before, or its channel was closed
        end = partial.filled + len(body)
        if end > len(partial.buffer):
            self.forget(channel)
            raise InvalidFrame(f"the parts on channel {channel} are longer than their message")
        partial.buffer[partial.filled : end] = body
        partial.filled = end
        if end == len(partial.buffer):
            self.forget(channel)
            p = partial
            done.append(Arrival(channel, p.encoding, bytes(p.buffer), p.origin, p.seq, p.stamp_ns, p.relayed))
