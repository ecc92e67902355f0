"""The other end of a link: operations in and out, topics out by freshness, messages in by channel.

Both roles use it: the ``rosbridge`` graph has one ``Peer`` per connection it made, the server one per client.
A peer that is another Ropeway gateway (subprotocol ``ropeway.1``) gets binary records, big messages in parts that
urgent ones overtake; everybody else gets plain rosbridge frames.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Protocol

from ropeway.errors import InvalidFrame, MessageTooBig, RopewayError, TypesError, WireError
from ropeway.link.auto import EncodingChooser
from ropeway.link.complaints import Complaints
from ropeway.link.outbox import LANES, Lost, Outbox, Queue
from ropeway.wire import codec as wire_codec
from ropeway.wire import filters, ops
from ropeway.wire.dialect import ROPEWAY, Dialect, by_subprotocol, detect
from ropeway.wire.fragment import Defragmenter, Fragmenter
from ropeway.wire.frames import loads
from ropeway.wire.records import Arrival, RecordReader, RecordWriter

if TYPE_CHECKING:
    from ropeway.link.connection import Connection
    from ropeway.types import MessageCodec, TypeRegistry

__all__ = ["CONTROL_OPS", "Channel", "Outgoing", "Peer", "PeerHandler"]

log = logging.getLogger("ropeway.link")

_PART_MIN_BYTES: Final = 4 * 1024
_PART_START_BYTES: Final = 16 * 1024
_PART_MAX_BYTES: Final = 1 << 20
_PART_S: Final = 0.002  # a part takes about so long on the wire, so that an urgent message waits no longer
_QUIET_S: Final = 10.0
_CONTROL_LIMIT_BYTES: Final = 32 << 20  # answers that a peer does not read; more closes the connection
_OFFLOAD_BYTES: Final = 1 << 20  # bigger messages are encoded in a thread

CONTROL_OPS: Final = frozenset(
    {"hello", "ping", "pong", "demand", "adopted", "watch", "graph", "definition", "refused", "stats"}
)


class Outgoing(Protocol):
    """What a peer needs of a message that goes out; ``ropeway.graph.Sample`` has it."""

    payload: bytes
    type: str
    stamp_ns: int
    origin: bytes
    seq: int
    relayed: bool

    def cached(self, key: object, make: Callable[[], Any]) -> Any:
        """See ``Sample.cached``."""


class PeerHandler(Protocol):
    """Who listens to a peer."""

    def operation(self, op: ops.Op) -> None:
        """A rosbridge operation came."""

    def control(self, message: Mapping[str, Any]) -> None:
        """A message of the Ropeway dialect came (``op`` is one of ``CONTROL_OPS``)."""

    def arrived(self, channel: int, arrivals: Sequence[Arrival]) -> None:
        """Messages came on a channel, still encoded."""

    def lost(self, code: int, reason: str) -> None:
        """The connection is gone."""


class Channel:
    """One topic that goes out on a peer."""

    __slots__ = (
        "chooser",
        "closed",
        "codec",
        "encoding",
        "fragment_size",
        "number",
        "peer",
        "queue",
        "sent",
        "sent_bytes",
        "topic",
        "type",
        "used",
    )

    def __init__(
        self, peer: Peer, number: int, topic: str, type: str, encoding: str, queue: Queue[Any], codec: Any
    ) -> None:
        self.peer, self.number, self.topic, self.type = peer, number, topic, type
        self.encoding = encoding
        self.queue: Queue[Outgoing] = queue
        self.queue.key = self
        self.codec: MessageCodec | None = codec
        self.chooser = EncodingChooser(peer.connection.pace) if encoding == "auto" else None
        self.used = encoding if encoding != "auto" else "none" if peer.dialect is not ROPEWAY else "cbor-raw"
        self.fragment_size: int | None = None  # characters; longer texts go in fragments
        self.sent = self.sent_bytes = 0
        self.closed = False

    def put(self, sample: Outgoing) -> None:
        """Let a message wait for its turn."""
        peer = self.peer
        if self.closed:
            self.queue.lost[Lost.UNSENT] += 1
            return
        if peer.connection.writable and peer.outbox.full(self.queue, len(sample.payload)):
            peer.pump()
        peer.outbox.put(self.queue, sample)
        peer.wake()

    def close(self) -> None:
        """Withdraw the topic; what waits is lost."""
        if not self.closed:
            self.closed = True
            self.peer.drop_channel(self)

    def pick(self, sample: Outgoing) -> str:
        """The encoding for this message."""
        if self.chooser is None:
            return self.encoding
        if self.peer.dialect is not ROPEWAY:
            return self.used
        queue = self.queue
        self.used = self.chooser.choose(
            len(sample.payload), self.sent, queue.lost[Lost.REPLACED] + queue.lost[Lost.OVERFLOW]
        )
        return self.used

    def frame(self, sample: Outgoing, encoding: str) -> wire_codec.Frame:
        """A plain ``publish``; made once however many peers get it."""
        dialect = self.peer.dialect
        made: wire_codec.Frame = sample.cached(
            ("frame", self.topic, encoding, dialect.name),
            lambda: wire_codec.encode_publish(
                self.topic, sample.payload, self.codec, encoding, dialect=dialect, stamp_ns=sample.stamp_ns
            ),
        )
        return made

    def encode(self, sample: Outgoing, encoding: str) -> bytes:
        """The body of a record; made once however many peers get it."""
        if encoding == "cbor-raw":
            return sample.payload
        body: bytes
        if encoding == "zstd":
            began = time.perf_counter()
            body = sample.cached(("body", "zstd"), lambda: filters.encode(sample.payload, self.type))
            if self.chooser is not None:
                self.chooser.measured(len(sample.payload), len(body), time.perf_counter() - began)
            return body
        body = sample.cached(
            ("body", encoding),
            lambda: wire_codec.encode_msg(encoding, sample.payload, self.codec, stamp_ns=sample.stamp_ns),
        )
        return body


class _Cursor:
    """A message that is being sent in parts; ``body`` is ``None`` while a thread encodes it."""

    __slots__ = ("at", "body", "channel", "encoding", "sample")

    def __init__(self, channel: Channel, sample: Outgoing, encoding: str, body: bytes | None) -> None:
        self.channel, self.sample, self.encoding = channel, sample, encoding
        self.body = body
        self.at = 0


class Peer:
    """See the module. ``limit_bytes`` bounds one inbound message after decompression."""

    def __init__(
        self,
        connection: Connection,
        registry: TypeRegistry,
        handler: PeerHandler,
        *,
        dialect: Dialect | None = None,
    ) -> None:
        self.connection = connection
        self.registry = registry
        self.handler = handler
        self.dialect = dialect or by_subprotocol(connection.subprotocol)
        self.limit_bytes = connection.limits.max_message_bytes
        self.complaints = Complaints(connection.peer)
        self.outbox: Outbox[Outgoing] = Outbox()
        self.channels: dict[int, Channel] = {}
        self.rtt_s: float | None = None
        self.clock_offset_ns: int | None = None  # the peer's clock minus ours, once it is measured
        self._offset_rtt = float("inf")
        self._cursors: list[_Cursor | None] = [None] * LANES
        self._writer = RecordWriter()
        self._reader = RecordReader(self.limit_bytes, self._refused)
        self._assembler = wire_codec.JsonAssembler(limit_bytes=self.limit_bytes)
        self._fragmenter = Fragmenter()
        self._fragments: deque[bytes] = deque()  # of the text that is being sent
        self._defragmenter = Defragmenter(limit_bytes=self.limit_bytes)
        self._scheduled = False
        self._part_bytes = _PART_START_BYTES
        self._samples_seen = 0
        self._quiet_bytes = 0
        self._loop = asyncio.get_running_loop()
        self._encoding: set[asyncio.Future[bytes]] = set()
        connection.on_text = self._on_text
        connection.on_binary = self._on_binary
        connection.on_writable = self.pump
        connection.on_closed = self._on_closed

    # ── out ────────────────────────────────────────────────────────────────────────────────────────────────────

    def send(self, op: ops.Op | Mapping[str, Any]) -> None:
        """Send an operation now. A peer that does not read its answers is closed with 1008."""
        connection = self.connection
        if connection.closed:
            return
        if not connection.writable and connection.unsent_bytes > _CONTROL_LIMIT_BYTES:
            connection.close(1008, "answers are not read")
            return
        message = op if isinstance(op, Mapping) else op.to_dict()
        connection.send_text(ops.dumps(message))

    def open_channel(
        self,
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
        codec = None
        if encoding not in ("auto", "cbor-raw", "rawzip", "zstd") or self.dialect is not ROPEWAY:
            codec = self.registry.codec(type) if encoding not in ("cbor-raw", "rawzip") else None
        lifespan_ns = None if lifespan_s is None else int(lifespan_s * 1e9)
        queue: Queue[Any] = Queue(topic, priority=priority, depth=depth, lifespan_ns=lifespan_ns)
        channel = Channel(self, number, topic, type, encoding, queue, codec)
        self.outbox.open(queue)
        self.channels[number] = channel
        return channel

    def drop_channel(self, channel: Channel) -> None:
        """Forget a channel; see ``Channel.close``."""
        self.outbox.close(channel.queue)
        if self.channels.get(channel.number) is channel:
            del self.channels[channel.number]
        for lane, cursor in enumerate(self._cursors):
            if cursor is not None and cursor.channel is channel:
                self._cursors[lane] = None
                self.wake()  # others may have waited for this lane

    def wake(self) -> None:
        """See that what waits is sent in this turn of the event loop."""
        if not self._scheduled and self.connection.writable:
            self._scheduled = True
            self._loop.call_soon(self._scheduled_pump)

    def _scheduled_pump(self) -> None:
        self._scheduled = False
        self.pump()

    def pump(self) -> None:
        """Send while the link takes it: the most urgent lane first, in each the freshest of every topic."""
        connection = self.connection
        if self.dialect is ROPEWAY:
            while connection.writable:
                frame = self._gather()
                if frame is None:
                    break
                connection.send_binary(frame)
                self._tune(len(frame))
        else:
            while connection.writable and self._send_plain():
                pass

    def _send_plain(self) -> bool:
        if self._fragments:
            self.connection.send_text(self._fragments.popleft())
            return True
        now = time.time_ns()
        for lane in self.outbox.lanes():
            taken = self.outbox.take(lane, now)
            if taken is None:
                continue
            queue, sample = taken
            channel: Channel = queue.key  # type: ignore[assignment]
            encoding = channel.pick(sample)
            try:
                frame = channel.frame(sample, encoding)
            except TypesError as error:
                queue.lost[Lost.ENCODE] += 1
                self.complaints.note("message", channel.topic, error)
                return True
            if frame.text and channel.fragment_size is not None:
                self._fragments.extend(self._fragmenter.split(frame.data, channel.fragment_size))
                self.connection.send_text(self._fragments.popleft())
            elif frame.text:
                self.connection.send_text(frame.data)
            else:
                self.connection.send_binary(frame.data)
            channel.sent += 1
            channel.sent_bytes += len(frame.data)
            return True
        return False

    def _gather(self) -> bytes | None:
        out: list[bytes] = []
        size = 0
        limit = self._part_bytes
        while size < limit:
            cursor = self._next()
            if cursor is None:
                break
            body = cursor.body
            assert body is not None
            channel, sample = cursor.channel, cursor.sample
            left = len(body) - cursor.at
            lane = channel.queue.priority
            if cursor.at == 0 and left <= limit - size:
                index = wire_codec.ENCODING_NUMBERS[cursor.encoding]
                self._writer.message(
                    out, channel.number, index, body, sample.origin, sample.seq, sample.stamp_ns, sample.relayed
                )
                part = left
            elif cursor.at == 0 and size and left <= limit:
                self._cursors[lane] = cursor
                break
            else:
                part = min(left, limit - size)
                view = memoryview(body)[cursor.at : cursor.at + part]
                if cursor.at == 0:
                    index = wire_codec.ENCODING_NUMBERS[cursor.encoding]
                    self._writer.first(
                        out,
                        channel.number,
                        index,
                        len(body),
                        view,
                        sample.origin,
                        sample.seq,
                        sample.stamp_ns,
                        sample.relayed,
                    )
                else:
                    self._writer.more(out, channel.number, view)
            cursor.at += part
            size += part + 28
            if cursor.at >= len(body):
                self._cursors[lane] = None
                channel.sent += 1
                channel.sent_bytes += len(body)
            else:
                self._cursors[lane] = cursor
        return b"".join(out) if out else None

    def _next(self) -> _Cursor | None:
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
                found = self._take(lane)
                if found is not None:
                    return found
                urgent = next(waiting, LANES)
        return None

    def _take(self, lane: int) -> _Cursor | None:
        while True:
            taken = self.outbox.take(lane, time.time_ns())
            if taken is None:
                return None
            queue, sample = taken
            channel: Channel = queue.key  # type: ignore[assignment]
            encoding = channel.pick(sample)
            if encoding != "cbor-raw" and len(sample.payload) >= _OFFLOAD_BYTES:
                cursor = _Cursor(channel, sample, encoding, None)
                self._cursors[lane] = cursor
                self._encode_in_thread(cursor, lane)
                return None
            try:
                body = channel.encode(sample, encoding)
            except TypesError as error:
                queue.lost[Lost.ENCODE] += 1
                self.complaints.note("message", channel.topic, error)
                continue
            return _Cursor(channel, sample, encoding, body)

    def _encode_in_thread(self, cursor: _Cursor, lane: int) -> None:
        channel, sample = cursor.channel, cursor.sample
        future = self._loop.run_in_executor(None, channel.encode, sample, cursor.encoding)
        self._encoding.add(future)

        def done(finished: asyncio.Future[bytes]) -> None:
            self._encoding.discard(finished)
            if finished.cancelled():
                return
            error = finished.exception()
            if self._cursors[lane] is not cursor:
                return
            if error is not None:
                self._cursors[lane] = None
                channel.queue.lost[Lost.ENCODE] += 1
                self.complaints.note("message", channel.topic, error)
            else:
                cursor.body = finished.result()
            self.pump()

        future.add_done_callback(done)

    def _tune(self, sent_bytes: int) -> None:
        """Fit the size of parts to the pace of the link."""
        pace, window = self.connection.pace, self.connection.window
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

    # ── in ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def _on_text(self, data: bytes) -> None:
        self._objects(data, text=True)

    def unpacked(self, text: bytes) -> None:
        """Take the operations of a text that came in fragments or in an image. Raises ``InvalidFrame``."""
        for message in loads(text, text=True):
            self._object(message)

    def _on_binary(self, data: bytes | memoryview) -> None:
        if self.dialect is not ROPEWAY:
            self._objects(bytes(data), text=False)
            return
        try:
            arrivals = self._reader.read(data)
        except InvalidFrame as error:
            self.complaints.note("frame", "", error)
            return
        if not arrivals:
            return
        first = arrivals[0].channel
        if len(arrivals) == 1 or all(a.channel == first for a in arrivals):
            self.handler.arrived(first, arrivals)
            return
        by_channel: dict[int, list[Arrival]] = {}
        for arrival in arrivals:
            by_channel.setdefault(arrival.channel, []).append(arrival)
        for channel, batch in by_channel.items():
            self.handler.arrived(channel, batch)

    def _objects(self, data: bytes, *, text: bool) -> None:
        try:
            objects = self._assembler.feed(data, text=text)
        except InvalidFrame as error:
            self.complaints.note("frame", "", error)
            return
        for message in objects:
            self._object(message)

    def _object(self, message: Mapping[str, Any]) -> None:
        op = message.get("op")
        if self.dialect is ROPEWAY and isinstance(op, str) and op in CONTROL_OPS:
            if op == "ping":
                self.send({"op": "pong", "t": message.get("t"), "r": time.time_ns()})
            elif op == "pong":
                self._pong(message)
            else:
                self._control(str(op), message)
            return
        try:
            parsed = ops.parse(message)
        except WireError as error:
            self.complaints.note("operation", str(message.get("topic", ""))[:200], error)
            return
        self.dialect = detect(self.dialect, parsed)
        try:
            if isinstance(parsed, ops.Fragment):
                text = self._defragmenter.add(parsed)
                if text is not None:
                    self.unpacked(text)
            else:
                self.handler.operation(parsed)
        except RopewayError as error:
            self.complaints.note(str(op), str(message.get("topic", ""))[:200], error)

    def _control(self, op: str, message: Mapping[str, Any]) -> None:
        try:
            self.handler.control(message)
        except RopewayError as error:
            self.complaints.note(op, "", error)

    def decode(self, arrival: Arrival, codec: MessageCodec | None) -> bytes:
        """The CDR of a message that came in a record. Raises ``DecodeError`` or ``MessageTooBig``."""
        if arrival.encoding == wire_codec.CBOR_RAW:
            return arrival.body
        encoding = wire_codec.encoding_name(arrival.encoding)
        if encoding == "zstd":
            return filters.decode(arrival.body, self.limit_bytes)
        return wire_codec.decode_msg(encoding, arrival.body, codec, limit_bytes=self.limit_bytes)

    def forget_inbound(self, channel: int) -> None:
        """Drop the unfinished message of an inbound channel."""
        self._reader.forget(channel)

    def _refused(self, channel: int, error: MessageTooBig) -> None:
        self.complaints.note("size", f"channel {channel}", error)
        self.send({"op": "refused", "channel": channel, "reason": str(error)})

    # ── the clock and the end ──────────────────────────────────────────────────────────────────────────────────

    def ping(self) -> None:
        """Measure the round trip and the difference of the clocks (Ropeway gateways only)."""
        if self.dialect is ROPEWAY:
            self.send({"op": "ping", "t": time.time_ns()})

    def _pong(self, message: Mapping[str, Any]) -> None:
        sent, remote = message.get("t"), message.get("r")
        now = time.time_ns()
        if not isinstance(sent, int) or not isinstance(remote, int) or not 0 <= now - sent < 60_000_000_000:
            return
        rtt = (now - sent) / 1e9
        self.rtt_s = rtt if self.rtt_s is None else self.rtt_s + 0.3 * (rtt - self.rtt_s)
        self._offset_rtt *= 1.02  # the best measurement ages, so that drifting clocks are followed
        if rtt <= self._offset_rtt:
            self._offset_rtt = rtt
            self.clock_offset_ns = remote - (sent + now) // 2

    def _on_closed(self, code: int, reason: str) -> None:
        for channel in list(self.channels.values()):
            channel.close()
        self.outbox.clear()
        for future in self._encoding:
            future.cancel()
        self.handler.lost(code, reason)
