"""Sends topics on a link, the most urgent lane first, in each the freshest of every topic.

``PlainSender`` sends whole rosbridge frames, for everybody. ``RecordSender`` sends binary records between Ropeway
gateways: many small messages in one frame, big ones in parts that urgent messages overtake.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar, Final

from ropeway.errors import TypesError
from ropeway.link.channel import Channel, Outgoing
from ropeway.link.outbox import LANES, Outbox, Queue
from ropeway.wire.codec import ENCODING_NUMBERS, NEEDS_CODEC, Frame
from ropeway.wire.fragment import Fragmenter
from ropeway.wire.records import HEADER_BYTES, RecordWriter

if TYPE_CHECKING:
    from ropeway.link.complaints import Complaints
    from ropeway.link.connection import Connection
    from ropeway.types import TypeRegistry
    from ropeway.wire.dialect import Dialect

__all__ = ["PlainSender", "RecordSender", "Sender"]

_PART_MIN_BYTES: Final = 4 * 1024
_PART_START_BYTES: Final = 16 * 1024
_PART_MAX_BYTES: Final = 1 << 20
_PART_S: Final = 0.002  # a part takes about so long on the wire, so that an urgent message waits no longer
_QUIET_S: Final = 10.0


class Sender:
    """What waits for one link, and the turn of the event loop in which it goes."""

    records: ClassVar[bool] = False

    def __init__(self, connection: Connection, complaints: Complaints, dialect: Dialect) -> None:
        self.connection, self.complaints, self.dialect = connection, complaints, dialect
        self.outbox: Outbox[Outgoing] = Outbox()
        self.channels: dict[int, Channel] = {}
        self._loop = asyncio.get_running_loop()
        self._scheduled = self._pumping = False
        self._encoding: set[asyncio.Future[object]] = set()

    def open(
        self,
        registry: TypeRegistry,
        number: int,
        topic: str,
        type: str,
        *,
        encoding: str,
        priority: int,
        depth: int | None,
        lifespan_s: float | None,
    ) -> Channel:
        """Make a topic ready to go out. Raises ``UnknownType`` if the encoding needs a definition nobody has."""
        lifespan_ns = None if lifespan_s is None else int(lifespan_s * 1e9)
        queue: Queue[Outgoing] = Queue(topic, priority=priority, depth=depth, lifespan_ns=lifespan_ns)
        channel = Channel(self, number, topic, type, encoding, queue, None)
        if channel.used in NEEDS_CODEC:
            channel.codec = registry.codec(type)
        self.outbox.open(queue)
        self.channels[number] = channel
        return channel

    def put(self, channel: Channel, sample: Outgoing, *, at_once: bool = False) -> None:
        """Let a message of a channel wait; what is full is sent first, if the link takes it."""
        if self.connection.writable and self.outbox.full(channel.queue, len(sample.payload)):
            self.pump()
        self.outbox.put(channel.queue, sample)
        self.wake(at_once=at_once)

    def drop(self, channel: Channel) -> None:
        """Forget a channel; what waits of it is lost."""
        self.outbox.close(channel.queue)
        if self.channels.get(channel.number) is channel:
            del self.channels[channel.number]

    def wake(self, *, at_once: bool = False) -> None:
        """See that what waits is sent in this turn of the event loop; with ``at_once`` the first of the turn now."""
        if not self._scheduled and self.connection.writable:
            self._scheduled = True
            self._loop.call_soon(self._scheduled_pump)
            if at_once:
                self.pump()

    def _scheduled_pump(self) -> None:
        self._scheduled = False
        self.pump()

    def pump(self) -> None:
        """Send while the link takes it. A call from inside goes on where it is."""
        if not self._pumping:
            self._pumping = True
            try:
                self._pump()
            finally:
                self._pumping = False

    def _pump(self) -> None:
        raise NotImplementedError

    def take(self, lane: int) -> tuple[Channel, Outgoing, str] | None:
        """The next message of a lane, its channel and its encoding."""
        taken = self.outbox.take(lane, time.time_ns())
        if taken is None:
            return None
        queue, sample = taken
        channel = queue.key
        assert isinstance(channel, Channel)
        return channel, sample, channel.pick(sample)

    def in_thread(self, make: Callable[[], object], then: Callable[[asyncio.Future[object]], None]) -> None:
        """Run ``make`` in a thread and ``then`` on the loop, unless the link closes first."""
        future = self._loop.run_in_executor(None, make)
        self._encoding.add(future)

        def done(finished: asyncio.Future[object]) -> None:
            self._encoding.discard(finished)
            if not finished.cancelled():
                then(finished)
                self.pump()

        future.add_done_callback(done)

    def close(self) -> None:
        """Lose everything that waits: the link is gone."""
        for channel in list(self.channels.values()):
            channel.close()
        self.outbox.clear()
        for future in self._encoding:
            future.cancel()


class PlainSender(Sender):
    """Sends rosbridge frames, in the order of their topics' turns."""

    def __init__(self, connection: Connection, complaints: Complaints, dialect: Dialect) -> None:
        super().__init__(connection, complaints, dialect)
        self._fragmenter = Fragmenter()
        self._fragments: deque[bytes] = deque()  # of the text that is being sent
        self._busy = False  # a thread encodes the next message

    def _pump(self) -> None:
        while self.connection.writable and not self._busy and self._send_next():
            pass

    def _send_next(self) -> bool:
        if self._fragments:
            self.connection.send_text(self._fragments.popleft())
            return True
        for lane in self.outbox.lanes():
            taken = self.take(lane)
            if taken is None:
                continue
            channel, sample, encoding = taken
            if channel.is_slow(sample, encoding):
                self._make_in_thread(channel, sample, encoding)
                return False
            try:
                self._send(channel, sample, channel.frame(sample, encoding))
            except TypesError as error:
                channel.failed(sample, error)
            return True
        return False

    def _make_in_thread(self, channel: Channel, sample: Outgoing, encoding: str) -> None:
        self._busy = True
        self.in_thread(lambda: channel.frame(sample, encoding), lambda finished: self._made(channel, sample, finished))

    def _made(self, channel: Channel, sample: Outgoing, finished: asyncio.Future[object]) -> None:
        self._busy = False
        error = finished.exception()
        if error is not None:
            channel.failed(sample, error)
        elif not channel.closed:
            frame = finished.result()
            assert isinstance(frame, Frame)
            self._send(channel, sample, frame)

    def _send(self, channel: Channel, sample: Outgoing, frame: Frame) -> None:
        if not frame.text:
            self.connection.send_binary(frame.data)
        elif (fragment_size := channel.fragments(sample)) is not None:
            self._fragments.extend(self._fragmenter.split(frame.data, fragment_size))
            self.connection.send_text(self._fragments.popleft())
        else:
            self.connection.send_text(frame.data)
        channel.finished(sample, len(frame.data))


class _Cursor:
    """A message that is being sent in parts; ``body`` is ``None`` while a thread encodes it."""

    __slots__ = ("at", "body", "channel", "encoding", "sample")

    def __init__(self, channel: Channel, sample: Outgoing, encoding: str, body: bytes | None) -> None:
        self.channel, self.sample, self.encoding = channel, sample, encoding
        self.body = body
        self.at = 0


class RecordSender(Sender):
    """Sends records; each lane has one message under way."""

    records = True

    def __init__(self, connection: Connection, complaints: Complaints, dialect: Dialect) -> None:
        super().__init__(connection, complaints, dialect)
        self._writer = RecordWriter()
        self._cursors: list[_Cursor | None] = [None] * LANES
        self._part_bytes = _PART_START_BYTES
        self._samples_seen = 0
        self._quiet_bytes = 0

    def drop(self, channel: Channel) -> None:
        """Forget a channel; what waits of it, or is half sent, is lost."""
        super().drop(channel)
        for lane, cursor in enumerate(self._cursors):
            if cursor is not None and cursor.channel is channel:
                self._cursors[lane] = None
                self.wake()  # others may have waited for this lane

    def _pump(self) -> None:
        connection = self.connection
        while connection.writable and (self.outbox.messages or any(self._cursors)):
            frame = self._gather()
            if frame is None:
                break
            connection.send_binary(frame)
            self._tune(len(frame))

    def _gather(self) -> bytes | None:
        """One frame: whole messages, or a part of one."""
        out: list[bytes] = []
        size = 0
        while size < self._part_bytes:
            cursor = self._next()
            if cursor is None:
                break
            assert cursor.body is not None
            room = self._part_bytes - size
            lane = cursor.channel.queue.priority
            if cursor.at == 0 and size and room < len(cursor.body) <= self._part_bytes:
                self._cursors[lane] = cursor  # it goes whole, in a frame of its own
                break
            size += self._append(out, cursor, room) + HEADER_BYTES
            if cursor.at >= len(cursor.body):
                self._cursors[lane] = None
                cursor.channel.finished(cursor.sample, len(cursor.body))
            else:
                self._cursors[lane] = cursor
        return b"".join(out) if out else None

    def _append(self, out: list[bytes], cursor: _Cursor, room: int) -> int:
        body, channel, sample = cursor.body, cursor.channel, cursor.sample
        assert body is not None
        left = len(body) - cursor.at
        part = min(left, room)
        if cursor.at:
            self._writer.more(out, channel.number, memoryview(body)[cursor.at : cursor.at + part])
        else:
            about = (sample.origin, sample.seq, sample.stamp_ns, sample.relayed)
            number = ENCODING_NUMBERS[cursor.encoding]
            if part == left:
                self._writer.message(out, channel.number, number, body, *about)
            else:
                self._writer.first(out, channel.number, number, left, memoryview(body)[:part], *about)
        cursor.at += part
        return part

    def _next(self) -> _Cursor | None:
        if not self.outbox.messages and not any(self._cursors):
            return None
        waiting = iter(self.outbox.lanes())
        urgent = next(waiting, LANES)
        for lane in range(LANES):
            cursor = self._cursors[lane]
            if cursor is not None:
                if cursor.body is not None:
                    return cursor
                if urgent == lane:
                    urgent = next(waiting, LANES)  # a thread is busy with this lane; look further down
                continue
            if lane == urgent:
                found = self._begin(lane)
                if found is not None:
                    return found
                urgent = next(waiting, LANES)
        return None

    def _begin(self, lane: int) -> _Cursor | None:
        while (taken := self.take(lane)) is not None:
            channel, sample, encoding = taken
            if channel.is_slow(sample, encoding):
                cursor = self._cursors[lane] = _Cursor(channel, sample, encoding, None)
                self._encode_in_thread(cursor, lane)
                return None
            try:
                return _Cursor(channel, sample, encoding, channel.body(sample, encoding))
            except TypesError as error:
                channel.failed(sample, error)
        return None

    def _encode_in_thread(self, cursor: _Cursor, lane: int) -> None:
        def then(finished: asyncio.Future[object]) -> None:
            if self._cursors[lane] is not cursor:
                return
            error = finished.exception()
            if error is not None:
                self._cursors[lane] = None
                cursor.channel.failed(cursor.sample, error)
            else:
                body = finished.result()
                assert isinstance(body, bytes)
                cursor.body = body

        self.in_thread(lambda: cursor.channel.body(cursor.sample, cursor.encoding), then)

    def _tune(self, sent_bytes: int) -> None:
        """Fit the size of parts to the pace of the link."""
        pace, window = self.connection.flow.pace, self.connection.flow.window
        if pace.bytes_per_s is not None:
            wanted = pace.bytes_per_s * _PART_S
        elif window is not None and window.limit is not None:
            wanted = window.limit / 2
        else:
            wanted = _PART_MAX_BYTES
        self._part_bytes = int(min(max(wanted, _PART_MIN_BYTES), _PART_MAX_BYTES))
        if pace.samples != self._samples_seen:
            self._samples_seen = pace.samples
            self._quiet_bytes = 0
            return
        self._quiet_bytes += sent_bytes
        if self._quiet_bytes > 4 * _PART_MAX_BYTES and pace.idle_s() > _QUIET_S:  # nothing was held back for long
            self._quiet_bytes = 0
            pace.forget()
