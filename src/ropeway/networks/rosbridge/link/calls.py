"""Operations with a body, such as calls and answers, on their way to a peer: in order, bounded, none replaced.

A Ropeway gateway gets them as CBOR in records, each priority on a channel of its own (``OP_CHANNELS``), so that a
command goes before the images and a large answer in parts that urgent messages overtake. Everybody else gets JSON
text, or CBOR where the peer named an encoding. What concerns one call or goal (operations with one ``id``) never
overtakes itself.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final

import orjson

from ropeway.delivery.outbox import LANES, SMALL_BYTES, Lost, Queue
from ropeway.errors import MessageTooBig, OutboxFull, RopewayError
from ropeway.networks.rosbridge.link.channel import Stream, StreamSender
from ropeway.networks.rosbridge.protocol import codec as wire_codec
from ropeway.networks.rosbridge.protocol import ops
from ropeway.types.cbor import dumps as cbor_dumps

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.protocol.dialect import Dialect
    from ropeway.types import MessageCodec

__all__ = ["OP_CHANNELS", "ROOM_BYTES", "WAITING_LIMIT_BYTES", "OpSender", "Unsent"]

OP_CHANNELS: Final = range(65536 - LANES, 65536)
"""The channels of operations, the most urgent first; topics have smaller numbers."""

WAITING_LIMIT_BYTES: Final = 64 << 20
"""The bytes that may wait for one link; as much as the largest message."""

ROOM_BYTES: Final = 1 << 20
"""The bytes waiting for one link above which no long work is begun that can wait: a second on a slow link."""

_URGENT_LANE: Final = 1
_BULK_LANE: Final = 4
_BULK_BYTES: Final = 64 << 10  # what takes longer than a command may, goes with the topics
_THREAD_BYTES: Final = 1 << 20  # encoding this takes milliseconds, which the event loop has not
_COPIED: Final = frozenset(("cbor-raw", "rawzip"))  # these take no time worth a thread
_PACK_BYTES: Final = 4096
_PACK_S: Final = 0.05  # a body that takes longer on the wire is compressed

Unsent = Callable[[RopewayError], None]


class _Operation:
    """An operation that waits; ``payload`` is its frame or record, or the CDR that a thread has yet to encode.

    A record of it has no origin, number or stamp.
    """

    __slots__ = ("fragment_size", "key", "make", "on_unsent", "payload", "text")

    origin: ClassVar[bytes] = bytes(16)
    seq: ClassVar[int] = 0
    stamp_ns: ClassVar[int] = 0
    relayed: ClassVar[bool] = False

    def __init__(
        self,
        payload: bytes,
        make: Callable[[], bytes] | None,
        key: str,
        fragment_size: int | None,
        on_unsent: Unsent | None,
        *,
        text: bool,
    ) -> None:
        self.payload, self.make, self.key = payload, make, key
        self.fragment_size, self.on_unsent, self.text = fragment_size, on_unsent, text

    def encode(self) -> bytes:
        """Return the frame or record. Raises ``TypesError``."""
        return self.payload if self.make is None else self.make()


class _Operations(Stream[_Operation]):
    """The operations of one priority. ``gone`` is also called with those that cannot be encoded."""

    __slots__ = ()

    def __init__(self, sender: StreamSender, number: int, lane: int, gone: Callable[[_Operation], None]) -> None:
        queue: Queue[_Operation] = Queue("calls", priority=lane, depth=None, limit_bytes=1 << 62)
        super().__init__(sender, number, "(calls)", queue, "cbor" if sender.records else "none")
        queue.ready_bytes = SMALL_BYTES  # larger ones may have to be encoded
        self.gone = gone

    def put(self, item: _Operation) -> None:
        """Send what is small now, if nothing was sent in this turn of the event loop and the link takes it."""
        if self.closed:
            self.queue.lost[Lost.UNSENT] += 1
        else:
            self.sender.put(self.queue, item, at_once=item.make is None and len(item.payload) <= _BULK_BYTES)

    def is_slow(self, item: _Operation, encoding: str) -> bool:
        """See ``Stream.is_slow``."""
        return item.make is not None

    def frame(self, item: _Operation, encoding: str) -> wire_codec.Frame:
        """See ``Stream.frame``."""
        return wire_codec.Frame(item.text, item.encode())

    def body(self, item: _Operation, encoding: str) -> bytes:
        """See ``Stream.body``."""
        return item.encode()

    def fragments(self, item: _Operation) -> int | None:
        """See ``Stream.fragments``."""
        return item.fragment_size

    def failed(self, item: _Operation, error: BaseException) -> None:
        """Tell the sender of an operation that it cannot be encoded."""
        super().failed(item, error)
        if self.gone is not None:
            self.gone(item)
        if item.on_unsent is not None and isinstance(error, RopewayError):
            item.on_unsent(error)


class OpSender:
    """Sends operations to one peer.

    ``records`` tells whether the peer reads them from records, ``limit_bytes`` what it takes at most in one message
    (``None`` where it has not said); both are set once it has said hello.
    """

    def __init__(self, sender: StreamSender) -> None:
        self._sender = sender
        self.records = False
        self.limit_bytes: int | None = None
        self._channels: dict[int, _Operations] = {}
        self._waiting: dict[str, tuple[int, int]] = {}  # by id: the lane and how many
        self._room: asyncio.Future[None] | None = None  # of those who wait for it
        self.count = 0  # of operations that wait
        self.on_gone: Callable[[], None] | None = None  # one of them has gone

    @property
    def waiting_bytes(self) -> int:
        """The bytes that wait for the link."""
        waiting = 0
        for channel in self._channels.values():
            waiting += channel.queue.bytes
        return waiting

    async def room(self) -> None:
        """Wait until no more than ``ROOM_BYTES`` wait for the link."""
        while self.waiting_bytes > ROOM_BYTES:
            if self._room is None:
                self._room = asyncio.get_running_loop().create_future()
            await asyncio.shield(self._room)

    def send(
        self,
        message: dict[str, Any],
        *,
        payload: bytes | None,
        field: str,
        codec: MessageCodec | None,
        encoding: str,
        priority: int | None,
        fragment_size: int | None,
        on_unsent: Unsent | None,
    ) -> None:
        """See ``Peer.send_op``."""
        size = len(payload) if payload is not None else 0
        if self.limit_bytes is not None and size > self.limit_bytes:
            raise MessageTooBig(size, self.limit_bytes)
        if self.records:
            used = "cbor-raw" if encoding == "auto" and size < _PACK_BYTES else self._encoding(encoding, size)
            write = _write_cbor
        else:
            dialect = self._sender.dialect
            used = encoding if encoding in dialect.bodies else "none"
            write = _write_json if used == "none" or payload is None else partial(_write_plain_cbor, dialect)
        make: Callable[[], bytes] | None = None
        if payload is not None and size >= _THREAD_BYTES and used not in _COPIED:
            data = payload

            def make() -> bytes:
                return write(message, data, field, codec, used)
        else:
            data = write(message, payload, field, codec, used)
        lane = _URGENT_LANE if priority is None and len(data) <= _BULK_BYTES else self._lane(priority, len(data))
        channel = self._channels.get(lane) or self._open(lane)
        if not self.count and make is None and len(data) <= SMALL_BYTES and self._sender.send_alone(channel, data):
            return
        waiting = self.waiting_bytes if self.count else 0
        if payload is not None and waiting and waiting + len(data) > WAITING_LIMIT_BYTES:
            raise OutboxFull(self._sender.connection.peer, waiting, WAITING_LIMIT_BYTES)
        id = message.get("id", ops.ABSENT)
        key = "" if id is ops.ABSENT or id is None else repr(id)
        behind = self._waiting.get(key)
        if behind is None:
            count = 0
        else:  # behind the others of its id
            lane, count = behind
            channel = self._channels[lane]
        if key:
            self._waiting[key] = (lane, count + 1)
        self.count += 1
        text = write is _write_json
        channel.put(_Operation(data, make, key, fragment_size, on_unsent, text=text))

    def _encoding(self, encoding: str, size: int) -> str:
        if encoding != "auto":
            return encoding if encoding in wire_codec.ENCODINGS and encoding != "png" else "none"
        pace = self._sender.connection.flow.pace.bytes_per_s
        slow = size >= _PACK_BYTES and pace is not None and size / pace > _PACK_S
        return "zstd" if slow else "cbor-raw"

    @staticmethod
    def _lane(priority: int | None, size: int) -> int:
        if priority is None:
            return _URGENT_LANE if size <= _BULK_BYTES else _BULK_LANE
        return min(max(priority, 0), LANES - 1)

    def _open(self, lane: int) -> _Operations:
        sender = self._sender
        number = OP_CHANNELS[lane] if sender.records else -1 - lane  # nobody else's, in either case
        channel = self._channels[lane] = _Operations(sender, number, lane, self._done)
        sender.add(channel)
        return channel

    def _done(self, op: _Operation) -> None:
        self.count -= 1
        if self.on_gone is not None:
            self.on_gone()
        if self._room is not None and self.waiting_bytes <= ROOM_BYTES:
            self._room.set_result(None)
            self._room = None
        if op.key:
            lane, count = self._waiting[op.key]
            if count > 1:
                self._waiting[op.key] = (lane, count - 1)
            else:
                del self._waiting[op.key]


def _write_json(
    message: Mapping[str, Any], payload: bytes | None, field: str, codec: MessageCodec | None, encoding: str
) -> bytes:
    if payload is None:
        return ops.dumps(message)
    return ops.dumps({**message, field: wire_codec.encode_value(payload, codec)})


def _write_plain_cbor(
    dialect: Dialect,
    message: Mapping[str, Any],
    payload: bytes,
    field: str,
    codec: MessageCodec | None,
    encoding: str,
) -> bytes:
    body = wire_codec.encode_value(payload, codec, encoding, dialect=dialect, stamp_ns=time.time_ns())
    return cbor_dumps({**message, field: body, "compression": encoding})


def _write_cbor(
    message: Mapping[str, Any], payload: bytes | None, field: str, codec: MessageCodec | None, encoding: str
) -> bytes:
    if payload is None:
        return cbor_dumps(message)
    if encoding == "cbor-raw" and len(payload) < wire_codec.COPIED_BYTES:
        return cbor_dumps({**message, "compression": encoding, field: payload})
    message = {**message, "compression": encoding}
    if encoding == "none":
        return cbor_dumps({**message, field: orjson.loads(wire_codec.encode_msg("none", payload, codec))})
    if encoding == "cbor":
        return cbor_dumps({**message, field: wire_codec.encode_value(payload, codec, "cbor")})
    body = payload if encoding == "cbor-raw" else wire_codec.encode_msg(encoding, payload, codec)
    message.pop(field, None)
    return wire_codec.cbor_with_bytes(message, field, body)
