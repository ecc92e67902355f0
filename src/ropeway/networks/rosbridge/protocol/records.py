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
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Final, NamedTuple

from ropeway.errors import InvalidFrame, MessageTooBig, WireError
from ropeway.limits import ORIGINS_PER_CONNECTION, UNFINISHED_MESSAGE_S, UNFINISHED_MESSAGES

__all__ = ["HEADER_BYTES", "Arrival", "RecordReader", "RecordWriter"]


MESSAGE: Final = 1
FIRST: Final = 2
MORE: Final = 3
ORIGIN: Final = 4

_HEADER: Final = struct.Struct("<BBHHHIQq")
_TOTAL: Final = struct.Struct("<I")
HEADER_BYTES: Final = _HEADER.size


class Arrival(NamedTuple):
    """A whole message as it came: ``body`` is still encoded."""

    channel: int
    encoding: int
    body: bytes
    origin: bytes
    seq: int
    stamp_ns: int
    relayed: bool = False


_arrival = tuple.__new__  # of a named tuple, without a call of Python per message


class RecordWriter:
    """Builds records for one direction of a connection."""

    def __init__(self) -> None:
        self._origins: OrderedDict[bytes, int] = OrderedDict()

    def _origin(self, origin: bytes, out: list[bytes]) -> int:
        index = self._origins.get(origin)
        if index is not None:
            return index
        if len(self._origins) < ORIGINS_PER_CONNECTION:
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
    """A message of which more is still to come. Its buffer grows with what comes, whatever total it announced."""

    __slots__ = ("buffer", "encoding", "origin", "relayed", "seq", "stamp_ns", "total", "touched_s")

    def __init__(self, encoding: int, total: int, origin: bytes, seq: int, stamp_ns: int, relayed: bool) -> None:
        self.encoding, self.origin, self.seq, self.stamp_ns, self.relayed = encoding, origin, seq, stamp_ns, relayed
        self.total = total
        self.buffer = bytearray()
        self.touched_s = 0.0  # when a part came


class RecordReader:
    """Reads the records of one direction of a connection.

    ``limit_bytes`` bounds a single message, and twice as much what all unfinished ones have. A message above it is
    reported to ``on_refused`` once and its parts are skipped; the connection goes on. So it does where ``takes`` says
    that nobody has this channel, and where nothing more came of a message for ``UNFINISHED_MESSAGE_S``, of which
    ``expire`` tells. ``clock`` counts seconds.
    """

    def __init__(
        self,
        limit_bytes: int,
        on_refused: Callable[[int, WireError], None],
        takes: Callable[[int], bool] = lambda channel: True,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.limit_bytes = limit_bytes
        self.pending_bytes = 0  # of unfinished messages
        self._on_refused, self._takes, self._clock = on_refused, takes, clock
        self._origins: dict[int, bytes] = {}
        self._partials: dict[int, _Partial] = {}

    def read(self, data: bytes | memoryview) -> list[Arrival]:
        """Return the messages that this frame completes.

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
                    body = bytes(view[at:end])
                    done.append(_arrival(Arrival, (channel, encoding, body, origin, seq, stamp_ns, flags & 1 != 0)))
            elif kind == MORE:
                self._more(channel, view[at:end], done)
            elif kind == FIRST:
                origin = origins.get(index)
                if origin is None or length < 4:
                    raise InvalidFrame(f"origin {index} was never declared, or the part has no length", size)
                self._first(channel, encoding, view[at:end], origin, seq, stamp_ns, bool(flags & 1), done)
            elif kind == ORIGIN:
                if length != 16 or index >= ORIGINS_PER_CONNECTION:
                    raise InvalidFrame(f"an origin has 16 bytes and a number below {ORIGINS_PER_CONNECTION}", size)
                origins[index] = bytes(view[at:end])
            else:
                raise InvalidFrame(f"records of kind {kind} are unknown", size)
            at = end
        return done

    def forget(self, channel: int) -> None:
        """Drop the unfinished message of a channel."""
        partial = self._partials.pop(channel, None)
        if partial is not None:
            self.pending_bytes -= len(partial.buffer)

    def clear(self) -> None:
        """Drop all unfinished messages."""
        self._partials.clear()
        self.pending_bytes = 0

    def expire(self) -> None:
        """Drop the unfinished messages of which nothing more came for too long."""
        oldest_s = self._clock() - UNFINISHED_MESSAGE_S
        for channel in [channel for channel, partial in self._partials.items() if partial.touched_s < oldest_s]:
            self.forget(channel)
            self._on_refused(channel, InvalidFrame(f"nothing more came of a message for {UNFINISHED_MESSAGE_S:g} s"))

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
        if total > self.limit_bytes:
            self._on_refused(channel, MessageTooBig(total, self.limit_bytes))
            return
        if not self._takes(channel):
            self._on_refused(channel, InvalidFrame("a message in parts came on a channel that nobody has"))
            return
        if len(self._partials) >= UNFINISHED_MESSAGES:
            self._on_refused(channel, InvalidFrame(f"{UNFINISHED_MESSAGES} messages are unfinished already"))
            return
        part = len(body) - 4
        if part > total:
            raise InvalidFrame(f"a first part of {part} bytes is longer than its message of {total}")
        if part == total:
            done.append(Arrival(channel, encoding, bytes(body[4:]), origin, seq, stamp_ns, relayed))
            return
        partial = _Partial(encoding, total, origin, seq, stamp_ns, relayed)
        self._partials[channel] = partial
        self._take(channel, partial, body[4:])

    def _more(self, channel: int, body: memoryview, done: list[Arrival]) -> None:
        partial = self._partials.get(channel)
        if partial is None:
            return  # refused before, or its channel was closed
        if len(partial.buffer) + len(body) > partial.total:
            self.forget(channel)
            raise InvalidFrame(f"the parts on channel {channel} are longer than their message")
        if not self._take(channel, partial, body):
            return
        if len(partial.buffer) == partial.total:
            self.forget(channel)
            p = partial
            done.append(Arrival(channel, p.encoding, bytes(p.buffer), p.origin, p.seq, p.stamp_ns, p.relayed))

    def _take(self, channel: int, partial: _Partial, part: memoryview) -> bool:
        """Add a part to its message; false where that is given up since too much is unfinished."""
        if self.pending_bytes + len(part) > 2 * self.limit_bytes:
            self.forget(channel)
            self._on_refused(channel, MessageTooBig(self.pending_bytes + len(part), 2 * self.limit_bytes))
            return False
        partial.buffer += part
        partial.touched_s = self._clock()
        self.pending_bytes += len(part)
        return True
