"""The other end of a link: operations in and out, topics out by freshness, messages in by channel.

Both roles use it: the ``rosbridge`` graph has one ``Peer`` per connection it made, the server one per client.
A peer that is another Ropeway gateway (subprotocol ``ropeway.1``) gets binary records, big messages in parts that
urgent ones overtake, calls and answers among them; everybody else gets plain rosbridge frames.
"""

from __future__ import annotations

import asyncio
import enum
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal, Protocol

from ropeway.delivery.codec_times import DECODING
from ropeway.delivery.compression import filters
from ropeway.errors import InvalidFrame, InvalidOperation, MessageTooBig, RopewayError, WireError
from ropeway.fault_log import FaultLog
from ropeway.limits import UNREAD_ANSWERS_BYTES
from ropeway.networks.rosbridge.link.calls import OP_CHANNELS, WAITING_LIMIT_BYTES, OpSender, Unsent
from ropeway.networks.rosbridge.link.channel import Channel, Outgoing
from ropeway.networks.rosbridge.link.express import Express
from ropeway.networks.rosbridge.link.sender import LinkSender, PlainSender, RecordSender
from ropeway.networks.rosbridge.protocol import codec as wire_codec
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY, ROSBRIDGE, Dialect, by_subprotocol, detect
from ropeway.networks.rosbridge.protocol.fragment import Defragmenter
from ropeway.networks.rosbridge.protocol.frames import loads
from ropeway.networks.rosbridge.protocol.records import Arrival, RecordReader
from ropeway.types.untrusted import cbor_loads

if TYPE_CHECKING:
    from ropeway.listener.connection import Connection
    from ropeway.types import MessageCodec, TypeRegistry

__all__ = ["CONTROL_OPS", "Channel", "Outgoing", "Peer", "PeerHandler", "Unsent", "Wrapping"]

CONTROL_OPS: Final = frozenset(
    {
        "hello",
        "ping",
        "pong",
        "demand",
        "adopted",
        "watch",
        "graph",
        "definition",
        "refused",
        "stats",
        "granted",
        "accepted",
        "cancelling",
        "state",
    }
)
_SECRET_CHARACTERS: Final = 64
_DRIFT_NS: Final = 1_000_000  # what clocks may run apart between two pings; a larger difference means that one was set
_CALLS: Final = 1  # calls and answers in records
_REQUESTS: Final = ("call_service", "send_action_goal")  # answered with or without an id


class Wrapping(enum.IntEnum):
    """The wrappers that the text of an operation came in, outermost first."""

    FRAGMENTS = 1
    IMAGE = 2


class PeerHandler(Protocol):
    """Handles what a peer sends."""

    def operation(self, op: ops.Op) -> None:
        """Handle a rosbridge operation."""

    def control(self, message: Mapping[str, Any]) -> None:
        """Handle a message of the Ropeway dialect (``op`` is one of ``CONTROL_OPS``)."""

    def arrived(self, channel: int, arrivals: Sequence[Arrival]) -> None:
        """Take messages that came on a channel, still encoded."""

    def takes(self, channel: int) -> bool:
        """Return whether messages are expected on a channel; parts of others are not even kept."""

    def lost(self, code: int, reason: str) -> None:
        """Handle the loss of the connection."""


class Peer:
    """A connection to a rosbridge peer, in either role. ``limit_bytes`` bounds one inbound message after
    decompression.
    """

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
        self.fault_log = FaultLog(connection.peer)
        kind = RecordSender if self.dialect is ROPEWAY else PlainSender
        self.sender: LinkSender = kind(connection, self.fault_log, self.dialect)
        self.express = Express(self)
        self.greeted = False  # a Ropeway gateway that has said hello
        self.takes_states = False  # it is a machine that holds the state that it is told
        self.heard_hello = asyncio.Event()
        self.op_sender = OpSender(self.sender)
        self.on_invalid: Callable[[Mapping[str, Any], WireError], None] = self._invalid  # what is no operation
        self.rtt_s: float | None = None
        self.on_round_trip: Callable[[float], None] = lambda _: None
        self.clock_offset_ns: int | None = None  # the peer's clock minus ours, once it is measured
        self._offset_rtt = float("inf")
        self.receivers: dict[int, Callable[[Sequence[Arrival]], None]] = {}
        """The receivers of messages by channel; the ``handler`` gets the rest."""
        self._reader = RecordReader(self.limit_bytes, self.refused, self.takes)
        self._assembler = wire_codec.JsonAssembler(limit_bytes=self.limit_bytes)
        self._defragmenter = Defragmenter(limit_bytes=self.limit_bytes)
        self._packing: Wrapping | None = None  # of the operations that are being taken
        connection.on_text = self.take_text
        gateway = self.dialect is ROPEWAY
        connection.on_binary = partial(self.take_records, self._reader) if gateway else self._on_binary
        connection.on_writable = self.sender.pump
        connection.on_closed = self._on_closed
        connection.on_look = self._expire
        hold = connection.account.hold
        hold("messages in parts", lambda: self._reader.pending_bytes)
        hold("fragments", lambda: self._defragmenter.held_bytes)
        hold("unfinished JSON", lambda: self._assembler.pending_bytes)
        hold("queues", lambda: self.sender.outbox.bytes)

    def speak(self, dialect: Dialect) -> None:
        """Speak to a plain peer as ``dialect``, from now on."""
        self.dialect = self.sender.dialect = dialect

    # ── out ────────────────────────────────────────────────────────────────────────────────────────────────────

    def send(self, op: ops.Op | Mapping[str, Any]) -> None:
        """Send an operation now. A peer that does not read its answers is closed with 1008."""
        connection = self.connection
        if connection.closed:
            return
        if not connection.writable and connection.unsent_bytes > UNREAD_ANSWERS_BYTES:
            connection.close(1008, "answers are not read")
            return
        message = op.to_dict() if isinstance(op, ops.Operation) else op
        connection.send_text(ops.dumps(message))

    def hello(self, gateway: str, name: str, *, express: bool = False) -> None:
        """Say who we are, to a Ropeway gateway; with ``express`` it may open a second connection."""
        offer = {"express": self.express.offer(), "states": True} if express else {}
        about = {"gateway": gateway, "name": name, "calls": _CALLS, "limit_bytes": self.limit_bytes}
        self.send({"op": "hello", **about, **offer})

    def send_op(
        self,
        op: ops.Op | Mapping[str, Any],
        *,
        payload: bytes | None = None,
        field: Literal["args", "values"] = "args",
        codec: MessageCodec | None = None,
        encoding: str = "auto",
        priority: int | None = None,
        fragment_size: int | None = None,
        on_unsent: Unsent | None = None,
    ) -> None:
        """Send an operation of services and actions; what has one ``id`` arrives in the order in which it is sent.

        ``payload`` is the CDR of the body, which takes the place of ``field``; ``None`` sends the operation as it is.
        A plain peer gets JSON text, in fragments of ``fragment_size`` characters where that is given, or CBOR where
        ``encoding`` is one that it may ask for. A Ropeway
        gateway gets the ``encoding`` that is asked for: ``auto`` is raw CDR, compressed on a slow link. ``codec`` may
        be ``None`` for encodings that need none, and not otherwise. ``priority`` is a lane, 0 to 7; left out, what is
        small goes in lane 1 and the rest in lane 4.

        With the connection closed nothing happens. Raises ``DecodeError`` for a payload that is not of its type,
        ``MessageTooBig`` for one that the peer would not take, ``OutboxFull`` if too much waits already; without a
        payload, a connection of which too much waits is closed with 1008. A large payload is encoded later: if that
        fails, ``on_unsent`` is called with the error.
        """
        if self.connection.closed:
            return
        message = op.to_dict() if isinstance(op, ops.Operation) else dict(op)
        sender = self.op_sender
        if self.dialect is ROPEWAY and not sender.records:  # a gateway that reads calls as text only
            if payload is not None:
                message[field] = wire_codec.encode_value(payload, codec)
            self.send(message)
            return
        if payload is None and sender.waiting_bytes > WAITING_LIMIT_BYTES + UNREAD_ANSWERS_BYTES:
            self.connection.close(1008, "answers are not read")
            return
        sender.send(
            message,
            payload=payload,
            field=field,
            codec=codec,
            encoding=encoding,
            priority=priority,
            fragment_size=fragment_size,
            on_unsent=on_unsent,
        )

    async def room_for_answers(self) -> None:
        """Wait while much waits for the peer: it reads slower than it asks."""
        await self.op_sender.room()

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
        channel = self.sender.open(
            self.registry,
            number,
            topic,
            type,
            encoding=encoding,
            priority=priority,
            depth=depth,
            lifespan_s=lifespan_s,
        )
        if self.sender.records:
            channel.express = self.express
        return channel

    def pump(self) -> None:
        """Send what waits, as far as the link takes it."""
        self.sender.pump()

    # ── in ─────────────────────────────────────────────────────────────────────────────────────────────────────

    def take_text(self, data: bytes) -> None:
        """Take a text frame, of either connection."""
        self._objects(data, text=True)

    def unpacked(self, text: bytes, packing: Wrapping) -> None:
        """Take the operations of a text that came in fragments or in an image. Raises ``InvalidFrame``.

        An image may come in fragments; nothing else is packed twice.
        """
        around = self._packing
        if around is not None and around >= packing:
            raise InvalidFrame(
                f"{packing.name.lower()} stand in {around.name.lower()}: an image may come in fragments, and no more",
                len(text),
            )
        self._packing = packing
        try:
            try:
                messages = loads(text, text=True)
            except InvalidFrame as error:
                if error.message is None:
                    raise
                self._refuse(error)
            else:
                for message in messages:
                    self._object(message)
        finally:
            self._packing = around

    def _on_binary(self, data: bytes | memoryview) -> None:
        self._objects(bytes(data), text=False)

    def take_records(self, reader: RecordReader, data: bytes | memoryview) -> None:
        """Take a frame of records; each connection has its reader."""
        try:
            arrivals = reader.read(data)
        except InvalidFrame as error:
            self.fault_log.note("frame", "", error)
            return
        batches: dict[int, list[Arrival]] = {}
        for arrival in arrivals:
            batch = batches.get(arrival.channel)
            if batch is None:
                batches[arrival.channel] = [arrival]
            else:
                batch.append(arrival)
        for channel, batch in batches.items():
            if channel in OP_CHANNELS:
                self._take_operations(batch)
            elif (receiver := self.receivers.get(channel)) is not None:
                receiver(batch)
            else:
                self.handler.arrived(channel, batch)

    def _take_operations(self, arrivals: Sequence[Arrival]) -> None:
        for arrival in arrivals:
            try:
                message = cbor_loads(arrival.body)
                if not isinstance(message, dict):
                    raise InvalidFrame("an operation is a map", len(arrival.body))
            except InvalidFrame as error:
                self._refuse(error)
            else:
                self._object(message)

    def _objects(self, data: bytes, *, text: bool) -> None:
        try:
            objects = self._assembler.feed(data, text=text)
        except InvalidFrame as error:
            self._refuse(error)
            return
        for message in objects:
            self._object(message)
        while self._assembler.refused:
            self._refuse(self._assembler.refused.pop(0))

    def _refuse(self, error: InvalidFrame) -> None:
        """Answer what can be answered of a frame that is of no use: by its id, if it says which operation it is."""
        message = error.message or {}
        op, id = message.get("op"), message.get("id", ops.ABSENT)
        known = isinstance(id, (str, int, float)) or (id is ops.ABSENT and op in _REQUESTS)
        if isinstance(op, str) and known:
            self.on_invalid(message, InvalidOperation(op, error.reason, id=id))
        else:
            self.fault_log.note("frame", "", error)

    def _object(self, message: Mapping[str, Any]) -> None:
        op = message.get("op")
        if self.dialect is ROPEWAY and isinstance(op, str) and op in CONTROL_OPS:
            if op == "ping":
                self.send({"op": "pong", "t": message.get("t"), "r": time.time_ns()})
            elif op == "pong":
                if not self.express.arrived(message):
                    self._pong(message)
            else:
                if op == "hello":
                    self._greeted(message)
                self._control(str(op), message)
            return
        try:
            parsed = ops.parse(message)
        except WireError as error:
            self.on_invalid(message, error)
            return
        if self.dialect is ROSBRIDGE:
            self.dialect = self.sender.dialect = detect(self.dialect, parsed)
        try:
            if isinstance(parsed, ops.Fragment):
                text = self._defragmenter.add(parsed)
                if text is not None:
                    self.unpacked(text, Wrapping.FRAGMENTS)
            else:
                self.handler.operation(parsed)
        except RopewayError as error:
            self.fault_log.note(str(op), str(message.get("topic", ""))[:200], error)

    def _invalid(self, message: Mapping[str, Any], error: WireError) -> None:
        self.fault_log.note("operation", str(message.get("topic", ""))[:200], error)

    def _greeted(self, message: Mapping[str, Any]) -> None:
        self.greeted = True
        limit = message.get("limit_bytes")
        self.op_sender.limit_bytes = limit if type(limit) is int and limit > 0 else None
        self.op_sender.records = self.op_sender.records or message.get("calls") == _CALLS
        self.takes_states = message.get("states") is True
        secret = message.get("express")
        self.heard_hello.set()
        self.express.offered = secret if isinstance(secret, str) and len(secret) <= _SECRET_CHARACTERS else ""

    def _control(self, op: str, message: Mapping[str, Any]) -> None:
        try:
            self.handler.control(message)
        except RopewayError as error:
            self.fault_log.note(op, "", error)

    def decode(self, arrival: Arrival, codec: MessageCodec | None) -> bytes:
        """Decode a message that came in a record to CDR. Raises ``DecodeError`` or ``MessageTooBig``."""
        if arrival.encoding == wire_codec.CBOR_RAW:
            return arrival.body
        encoding = wire_codec.encoding_name(arrival.encoding)
        limit_bytes, body = self.limit_bytes, arrival.body
        if encoding == "zstd":
            return DECODING.timed(encoding, lambda: filters.decode(body, limit_bytes))
        return DECODING.timed(encoding, lambda: wire_codec.decode_msg(encoding, body, codec, limit_bytes=limit_bytes))

    def forget_inbound(self, channel: int) -> None:
        """Forget an inbound channel, with its unfinished message."""
        self._reader.forget(channel)
        self.receivers.pop(channel, None)

    def takes(self, channel: int) -> bool:
        """Return whether records of a channel are expected."""
        return channel in OP_CHANNELS or self.handler.takes(channel)

    def refused(self, channel: int, error: WireError) -> None:
        """Note a message of a channel that was refused."""
        self.fault_log.note("size" if isinstance(error, MessageTooBig) else "frame", f"channel {channel}", error)
        if isinstance(error, MessageTooBig):
            self.send({"op": "refused", "channel": channel, "reason": str(error)})

    def _expire(self) -> None:
        """Drop unfinished messages of which nothing more comes."""
        self._reader.expire()
        self._defragmenter.expire()

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
        self.on_round_trip(rtt)
        self._offset_rtt *= 1.02  # the best measurement ages, so that drifting clocks are followed
        offset = self.clock_offset_ns
        was_set = offset is not None and not remote - now - _DRIFT_NS <= offset <= remote - sent + _DRIFT_NS
        if rtt <= self._offset_rtt or was_set:
            self._offset_rtt = rtt
            self.clock_offset_ns = remote - (sent + now) // 2

    def _on_closed(self, code: int, reason: str) -> None:
        self.express.close()
        self.sender.close()
        self._reader.clear()
        self._defragmenter.clear()
        self._assembler.clear()
        self.handler.lost(code, reason)
