"""Sends topics on a link, the most urgent lane first, in each the freshest of every topic.

``PlainSender`` sends whole rosbridge frames, for everybody. ``RecordSender`` sends binary records between Ropeway
gateways: many small messages in one frame, big ones in parts that urgent and small messages overtake.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar, Final

from ropeway.delivery.outbox import LANES, SMALL_BYTES, Outbox, Queue
from ropeway.errors import TypesError
from ropeway.networks.rosbridge.link.channel import Channel, Outgoing
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
_AHEAD_S: Final = 0.004  # before the end of a message the next is encoded, so that the link does not wait for it


class LinkSender:
    """What waits for one link, and the turn of the event loop in which it goes."""

    records: ClassVar[bool] = False

    def __init__(self, connection: Connection, fault_log: FaultLog, dialect: Dialect) -> None:
        self.connection, self.fault_log, self.dialect = connection, fault_log, dialect
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

    def take(self, lane: int, *, small: bool = False) -> tuple[Channel, Outgoing, str] | None:
        """The next message of a lane, its channel and its encoding."""
        taken = self.outbox.take(lane, time.time_ns(), small=small)
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


class PlainSender(LinkSender):
    """Sends rosbridge frames, in the order of their topics' turns."""

    def __init__(self, connection: Connection, fault_log: FaultLog, dialect: Dialect) -> None:
        super().__init__(connection, fault_log, dialect)
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
                self._failed(channel, sample, error)
            return True
        return False

    def _failed(self, channel: Channel, sample: Outgoing, error: BaseException) -> None:
        self.outbox.done(channel.queue)
        channel.failed(sample, error)

    def _make_in_thread(self, channel: Channel, sample: Outgoing, encoding: str) -> None:
        self._busy = True
        self.in_thread(lambda: channel.frame(sample, encoding), lambda finished: self._made(channel, sample, finished))

    def _made(self, channel: Channel, sample: Outgoing, finished: asyncio.Future[object]) -> None:
        self._busy = False
        error = finished.exception()
        if error is not None:
            self._failed(channel, sample, error)
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
        self.outbox.served(channel.queue, len(frame.data))
        self.outbox.done(channel.queue)
        channel.finished(sample, len(frame.data))


class _Cursor:
    """A message that is being sent in parts; ``body`` is ``None`` while a thread encodes it."""

    __slots__ = ("at", "body", "channel", "encoding", "sample")

    def __init__(self, channel: Channel, sample: Outgoing, encoding: str, body: bytes | None) -> None:
        self.channel, self.sample, self.encoding = channel, sample, encoding
        self.body = body
        self.at = 0


class RecordSender(LinkSender):
    """Sends records; of the messages of a lane that are under way the last begun goes on first."""

    records = True

    def __init__(self, connection: Connection, fault_log: FaultLog, dialect: Dialect) -> None:
        super().__init__(connection, fault_log, dialect)
        self._writer = RecordWriter()
        self._under_way: list[list[_Cursor]] = [[] for _ in range(LANES)]
        self._parts = 0  # messages under way, in all lanes

    def drop(self, channel: Channel) -> None:
        """Forget a channel; what waits of it, or is half sent, is lost."""
        super().drop(channel)
        self.withdraw(channel)
        self.wake()  # others may have waited for this lane

    def withdraw(self, channel: Channel) -> None:
        """Stop sending the message of a channel that is under way, if there is one."""
        for cursor in self._under_way[channel.queue.priority]:
            if cursor.channel is channel:
                self._end(cursor)
                return

    def _pump(self) -> None:
        connection = self.connection
        while connection.writable and (self.outbox.messages or self._parts):
            frame = self._gather()
            if frame is None:
                break
            connection.send_binary(frame)

    def _gather(self) -> bytes | None:
        """One frame: whole messages, or a part of one."""
        out: list[bytes] = []
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
                cursor.channel.finished(cursor.sample, len(body))
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
        self.outbox.served(channel.queue, part + HEADER_BYTES)
        return part

    def _next(self) -> _Cursor | None:
        """The message whose turn it is; it is under way from now on."""
        outbox = self.outbox
        if not self._parts:
            for lane in outbox.lanes():
                found = self._begin(lane)
                if found is not None:
                    return found
            return None
        for lane, under_way in enumerate(self._under_way):
            current = next((cursor for cursor in reversed(under_way) if cursor.body is not None), None)
            if current is None:
                current = self._begin(lane)
            elif outbox.overtakes(lane, current.channel.queue) and len(current.sample.payload) > SMALL_BYTES:
                current = self._begin(lane, small=True) or current
            elif len(under_way) == 1 and current.at:
                self._prepare_next(lane, current)
            if current is not None:
                return current
        return None

    def _begin(self, lane: int, *, small: bool = False) -> _Cursor | None:
        while (taken := self.take(lane, small=small)) is not None:
            channel, sample, encoding = taken
            cursor = _Cursor(channel, sample, encoding, None)
            self._under_way[lane].append(cursor)
            self._parts += 1
            if channel.is_slow(sample, encoding):
                self._encode_in_thread(cursor)
                continue
            try:
                cursor.body = channel.body(sample, encoding)
                return cursor
            except TypesError as error:
                self._end(cursor)
                channel.failed(sample, error)
        return None

    def _prepare_next(self, lane: int, current: _Cursor) -> None:
        """Have a thread encode the message that comes after the one that is nearly sent, if that takes time."""
        pace = self.connection.flow.pace.bytes_per_s
        assert current.body is not None
        if pace is None or len(current.body) - current.at > pace * _AHEAD_S:
            return
        first = self.outbox.first(lane)
        if first is None:
            return
        channel = first[0].key
        assert isinstance(channel, Channel)
        if channel.is_slow(first[1], channel.used) and (taken := self.take(lane)) is not None:
            channel, sample, encoding = taken
            cursor = _Cursor(channel, sample, encoding, None)
            self._under_way[lane].insert(0, cursor)  # it follows the current one
            self._parts += 1
            self._encode_in_thread(cursor)

    def _end(self, cursor: _Cursor) -> None:
        queue = cursor.channel.queue
        self._under_way[queue.priority].remove(cursor)
        self._parts -= 1
        self.outbox.done(queue)

    def _encode_in_thread(self, cursor: _Cursor) -> None:
        channel = cursor.channel

        def then(finished: asyncio.Future[object]) -> None:
            if cursor not in self._under_way[channel.queue.priority]:
                return
            error = finished.exception()
            if error is not None:
                self._end(cursor)
                channel.failed(cursor.sample, error)
            else:
                body = finished.result()
                assert isinstance(body, bytes)
                cursor.body = body

        self.in_thread(lambda: channel.body(cursor.sample, cursor.encoding), then)

    def _part_bytes(self) -> int:
        """The size of a part: what the link carries in a moment, so that nothing urgent waits for more."""
        flow = self.connection.flow
        if not flow.known:
            return _PART_MAX_BYTES
        pace = flow.pace.bytes_per_s
        wanted = 0.0 if pace is None else pace * _PART_S
        if flow.model.starting:  # the pace is a lower bound, and next to us it says how fast we are ourselves
            wanted = max(wanted, flow.model.window_bytes / (1 if flow.model.near else 4))
        return int(max(min(wanted, flow.model.room_bytes, _PART_MAX_BYTES), _PART_MIN_BYTES))
