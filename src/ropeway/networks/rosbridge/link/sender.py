"""Sends topics on a link, the most urgent lane first, in each the freshest of every topic.

``PlainSender`` sends whole rosbridge frames, for everybody. ``RecordSender`` sends binary records between Ropeway
gateways: many small messages in one frame, big ones in parts that urgent and small messages overtake.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Final

from ropeway.delivery.outbox import LANES, SMALL_BYTES, Message, Outbox, Queue
from ropeway.errors import TypesError
from ropeway.networks.rosbridge.link.channel import Channel, Outgoing, Stream
from ropeway.networks.rosbridge.protocol.codec import ENCODING_NUMBERS, NEEDS_CODEC, Frame
from ropeway.networks.rosbridge.protocol.fragment import Fragmenter
from ropeway.networks.rosbridge.protocol.records import HEADER_BYTES, RecordWriter

if TYPE_CHECKING:
    from ropeway.fault_log import FaultLog
    from ropeway.listener.connection import Connection
    from ropeway.networks.rosbridge.protocol.dialect import Dialect
    from ropeway.types import TypeRegistry

__all__ = ["LinkSender", "PlainSender", "RecordSender"]

_PART_MIN_BYTES: Final = 1400  # what a packet carries
_PART_MAX_BYTES: Final = 1 << 20
_PART_S: Final = 0.002  # a part takes about so long on the wire, so that an urgent message waits no longer
_NO_ORIGIN: Final = bytes(16)
_AHEAD_S: Final = 0.004  # before the end of a message the next is encoded, so that the link does not wait for it


class LinkSender:
    """Holds what waits for one link, and sends it once per turn of the event loop.

    ``second`` tells whether it sends on a second connection; ``recent`` is what it sent last, where that may have to go
    again.
    """

    records: ClassVar[bool] = False
    second: ClassVar[bool] = False

    def __init__(self, connection: Connection, fault_log: FaultLog, dialect: Dialect) -> None:
        self.connection, self.fault_log, self.dialect = connection, fault_log, dialect
        self.flow = connection.flow
        self.outbox: Outbox[Any] = Outbox()
        self.channels: dict[int, Stream[Any]] = {}
        self.recent: deque[tuple[Stream[Any], Any]] | None = None
        self._loop = asyncio.get_running_loop()
        self._scheduled = self._pumping = False
        self.unfinished = 0
        """The number of messages, in all lanes, of which a part was sent."""
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
        self.add(channel)
        return channel

    def add(self, stream: Stream[Any]) -> None:
        """Make a stream ready to go out."""
        self.outbox.open(stream.queue)
        self.channels[stream.number] = stream

    def put(self, queue: Queue[Any], item: Message, *, at_once: bool = False) -> None:
        """Let a message wait; what is full is sent first, if the link takes it.

        What waits is sent in this turn of the event loop; with ``at_once`` the first of the turn now.
        """
        free, outbox = self.flow.free, self.outbox
        if free and queue.waiting and outbox.full(queue, len(item.payload)):
            self.pump()
            free = self.flow.free
        outbox.put(queue, item)
        if free and not self._scheduled:
            self._scheduled = True
            self._loop.call_soon(self.pump, True)
            if at_once:
                self.pump()

    def send_alone(self, stream: Stream[Any], body: bytes) -> bool:
        """See ``StreamSender.send_alone``; only records are sent so."""
        return False

    def drop(self, stream: Stream[Any]) -> None:
        """Forget a stream; what waits of it is lost."""
        self.outbox.close(stream.queue)
        if self.channels.get(stream.number) is stream:
            del self.channels[stream.number]

    def wake(self) -> None:
        """See that what waits is sent in this turn of the event loop."""
        if not self._scheduled and self.flow.free:
            self._scheduled = True
            self._loop.call_soon(self.pump, True)

    def pump(self, scheduled: bool = False) -> None:
        """Send while the link takes it. A call from inside goes on where it is."""
        if scheduled:
            self._scheduled = False
        if not self._pumping and (self.outbox.messages or self.unfinished):
            self._pumping = True
            try:
                flow = self.flow
                while flow.free and self._send_next():
                    pass
            finally:
                self._pumping = False

    def _send_next(self) -> bool:
        """Send the next frame; return whether there may be another."""
        raise NotImplementedError

    def take(self, lane: int, *, small: bool = False) -> tuple[Stream[Any], Any, str] | None:
        """Take the next message of a lane; return its stream, the message and its encoding."""
        taken = self.outbox.take(lane, time.time_ns(), small=small)
        if taken is None:
            return None
        queue, item = taken
        stream: Stream[Any] = queue.key
        if self.recent is not None:
            self.recent.append((stream, item))
        return stream, item, stream.pick(item)

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
        """Drop everything that waits: the link is gone."""
        for channel in list(self.channels.values()):
            channel.close()
        self.outbox.clear()
        for future in self._encoding:
            future.cancel()


class PlainSender(LinkSender):
    """Sends rosbridge frames, in the order of their topics' turns."""

    def __init__(self, connection: Connection, fault_log: FaultLog, dialect: Dialect) -> None:
        super().__init__(connection, fault_log, dialect)
        self._fragmenter = Fragmenter()
        self._fragments: deque[bytes] = deque()  # of the text that is being sent
        self._busy = False  # a thread encodes the next message

    def _send_next(self) -> bool:
        if self._busy:
            return False
        if self._fragments:
            self.connection.send_text(self._fragments.popleft())
            self.unfinished = bool(self._fragments)
            return True
        for lane in self.outbox.lanes():
            taken = self.take(lane)
            if taken is None:
                continue
            stream, item, encoding = taken
            if stream.is_slow(item, encoding):
                self._make_in_thread(stream, item, encoding)
                return False
            try:
                self._send(stream, item, stream.frame(item, encoding))
            except TypesError as error:
                self._failed(stream, item, error)
            return True
        return False

    def _failed(self, stream: Stream[Any], item: Any, error: BaseException) -> None:
        self.outbox.done(stream.queue)
        stream.failed(item, error)

    def _make_in_thread(self, stream: Stream[Any], item: Any, encoding: str) -> None:
        self._busy = True
        self.in_thread(lambda: stream.frame(item, encoding), lambda finished: self._made(stream, item, finished))

    def _made(self, stream: Stream[Any], item: Any, finished: asyncio.Future[object]) -> None:
        self._busy = False
        error = finished.exception()
        if error is not None:
            self._failed(stream, item, error)
        elif not stream.closed:
            frame = finished.result()
            assert isinstance(frame, Frame)
            self._send(stream, item, frame)

    def _send(self, stream: Stream[Any], item: Any, frame: Frame) -> None:
        if not frame.text:
            self.connection.send_binary(frame.data)
        elif (fragment_size := stream.fragments(item)) is not None:
            self._fragments.extend(self._fragmenter.split(frame.data, fragment_size))
            self.connection.send_text(self._fragments.popleft())
            self.unfinished = bool(self._fragments)
        else:
            self.connection.send_text(frame.data)
        self.outbox.served(stream.queue, len(frame.data))
        self.outbox.done(stream.queue)
        stream.finished(item, len(frame.data))


class _Cursor:
    """A message that is being sent in parts; ``body`` is ``None`` while a thread encodes it."""

    __slots__ = ("at", "body", "encoding", "item", "stream")

    def __init__(self, stream: Stream[Any], item: Any, encoding: str) -> None:
        self.stream, self.item, self.encoding = stream, item, encoding
        self.body: bytes | None = None
        self.at = 0


class RecordSender(LinkSender):
    """Sends records; of the messages of a lane that are under way the last begun goes on first."""

    records = True

    def __init__(self, connection: Connection, fault_log: FaultLog, dialect: Dialect) -> None:
        super().__init__(connection, fault_log, dialect)
        self._writer = RecordWriter()
        self._under_way: list[list[_Cursor]] = [[] for _ in range(LANES)]

    def drop(self, stream: Stream[Any]) -> None:
        """Forget a stream; what waits of it, or is half sent, is lost."""
        super().drop(stream)
        self.withdraw(stream)
        self.wake()  # others may have waited for this lane

    def send_alone(self, stream: Stream[Any], body: bytes) -> bool:
        """See ``StreamSender.send_alone``; the record has no origin, number or stamp."""
        outbox = self.outbox
        if self._scheduled or outbox.messages or self.unfinished or self.recent is not None or not self.flow.free:
            return False
        size = len(body)
        out: list[bytes] = []
        self._writer.message(out, stream.number, stream.ready, body, _NO_ORIGIN, 0, 0)
        stream.sent += 1
        stream.sent_bytes += size
        outbox.passed(stream.queue, size + HEADER_BYTES)
        self._scheduled = True
        self._loop.call_soon(self.pump, True)
        self.connection.send_binary(b"".join(out))
        return True

    def withdraw(self, stream: Stream[Any]) -> None:
        """Stop sending the message of a stream that is under way, if there is one."""
        for cursor in self._under_way[stream.queue.priority]:
            if cursor.stream is stream:
                self._end(cursor)
                return

    def _send_next(self) -> bool:
        """Send small messages that go as they are, in one frame; if none is next, a part of a large one."""
        outbox, recent, write = self.outbox, self.recent, self._writer.message
        out: list[bytes] = []
        if not outbox.messages and not self.unfinished:
            return False
        if not self.unfinished:
            room = _PART_MIN_BYTES if outbox.messages == 1 else self._part_bytes()
            now_ns = time.time_ns()
            while outbox.messages and (taken := outbox.take_ready(room, HEADER_BYTES, now_ns)) is not None:
                queue, item = taken
                stream: Stream[Any] = queue.key
                if recent is not None:
                    recent.append((stream, item))
                body = item.payload
                write(out, stream.number, stream.ready, body, item.origin, item.seq, item.stamp_ns, item.relayed)
                size = len(body)
                room -= size + HEADER_BYTES
                stream.sent += 1
                stream.sent_bytes += size
                if stream.gone is not None:
                    stream.gone(item)
        if not out:
            self._gather(out)
            if not out:
                return False
        self.connection.send_binary(b"".join(out))
        return bool(outbox.messages or self.unfinished)

    def _gather(self, out: list[bytes]) -> None:
        """Gather one frame: whole messages, or a part of one."""
        size = 0
        part_bytes = self._part_bytes()
        while size < part_bytes:
            cursor = self._next()
            if cursor is None:
                break
            body = cursor.body
            assert body is not None
            room = part_bytes - size
            if cursor.at == 0 and size and room < len(body) <= part_bytes:
                break  # it goes whole, in a frame of its own
            size += self._append(out, cursor, room) + HEADER_BYTES
            if cursor.at >= len(body):
                self._end(cursor)
                cursor.stream.finished(cursor.item, len(body))

    def _append(self, out: list[bytes], cursor: _Cursor, room: int) -> int:
        body, stream, item = cursor.body, cursor.stream, cursor.item
        assert body is not None
        left = len(body) - cursor.at
        part = min(left, room)
        if cursor.at:
            self._writer.more(out, stream.number, memoryview(body)[cursor.at : cursor.at + part])
        else:
            about = (item.origin, item.seq, item.stamp_ns, item.relayed)
            number = ENCODING_NUMBERS[cursor.encoding]
            if part == left:
                self._writer.message(out, stream.number, number, body, *about)
            else:
                self._writer.first(out, stream.number, number, left, memoryview(body)[:part], *about)
        cursor.at += part
        self.outbox.served(stream.queue, part + HEADER_BYTES)
        return part

    def _next(self) -> _Cursor | None:
        """Return the message whose turn it is, and mark it as under way."""
        outbox = self.outbox
        if not self.unfinished:
            for lane in outbox.lanes():
                found = self._begin(lane)
                if found is not None:
                    return found
            return None
        for lane, under_way in enumerate(self._under_way):
            current = next((cursor for cursor in reversed(under_way) if cursor.body is not None), None)
            if current is None:
                current = self._begin(lane)
            elif outbox.overtakes(lane, current.stream.queue) and len(current.item.payload) > SMALL_BYTES:
                current = self._begin(lane, small=True) or current
            elif len(under_way) == 1 and current.at:
                self._prepare_next(lane, current)
            if current is not None:
                return current
        return None

    def _begin(self, lane: int, *, small: bool = False) -> _Cursor | None:
        while (taken := self.take(lane, small=small)) is not None:
            stream, item, encoding = taken
            cursor = _Cursor(stream, item, encoding)
            self._under_way[lane].append(cursor)
            self.unfinished += 1
            if stream.is_slow(item, encoding):
                self._encode_in_thread(cursor)
                continue
            try:
                cursor.body = stream.body(item, encoding)
                return cursor
            except TypesError as error:
                self._end(cursor)
                stream.failed(item, error)
        return None

    def _prepare_next(self, lane: int, current: _Cursor) -> None:
        """Let a thread encode the message that follows the one that is nearly sent, if that takes time."""
        pace = self.connection.flow.pace.bytes_per_s
        assert current.body is not None
        if pace is None or len(current.body) - current.at > pace * _AHEAD_S:
            return
        first = self.outbox.first(lane)
        if first is None:
            return
        stream: Stream[Any] = first[0].key
        if stream.is_slow(first[1], stream.used) and (taken := self.take(lane)) is not None:
            stream, item, encoding = taken
            cursor = _Cursor(stream, item, encoding)
            self._under_way[lane].insert(0, cursor)  # it follows the current one
            self.unfinished += 1
            self._encode_in_thread(cursor)

    def _end(self, cursor: _Cursor) -> None:
        queue = cursor.stream.queue
        self._under_way[queue.priority].remove(cursor)
        self.unfinished -= 1
        self.outbox.done(queue)

    def _encode_in_thread(self, cursor: _Cursor) -> None:
        stream = cursor.stream

        def then(finished: asyncio.Future[object]) -> None:
            if cursor not in self._under_way[stream.queue.priority]:
                return
            error = finished.exception()
            if error is not None:
                self._end(cursor)
                stream.failed(cursor.item, error)
            else:
                body = finished.result()
                assert isinstance(body, bytes)
                cursor.body = body

        self.in_thread(lambda: stream.body(cursor.item, cursor.encoding), then)

    def _part_bytes(self) -> int:
        """Return the size of a part: what the link carries in a moment, so that nothing urgent waits longer."""
        flow = self.connection.flow
        if not flow.known:
            return _PART_MAX_BYTES
        pace = flow.pace.bytes_per_s
        wanted = 0.0 if pace is None else pace * _PART_S
        if flow.model.starting:  # the pace is a lower bound, and next to us it says how fast we are ourselves
            wanted = max(wanted, flow.model.window_bytes / (1 if flow.model.near else 4))
        return int(max(min(wanted, flow.model.room_bytes, _PART_MAX_BYTES), _PART_MIN_BYTES))
