"""Sends a topic out on a link: holds what waits, and decides how it is encoded."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, Generic, Protocol, TypeVar

from ropeway.delivery.codec_times import ENCODING
from ropeway.delivery.compression import filters
from ropeway.delivery.encoding_choice import SMALLEST_PACKED_BYTES, EncodingChooser
from ropeway.delivery.outbox import SMALL_BYTES, Lost, Message, Outbox, Queue
from ropeway.networks.rosbridge.protocol import codec as wire_codec

if TYPE_CHECKING:
    from ropeway.fault_log import FaultLog
    from ropeway.listener.connection import Connection
    from ropeway.networks.rosbridge.protocol.dialect import Dialect
    from ropeway.types import MessageCodec

__all__ = ["EXPRESS_BYTES", "Channel", "Outgoing", "Placing", "Stream", "StreamSender"]

EXPRESS_BYTES: Final = 4 * 1024
"""The largest message that takes the second connection."""

_BIG_BYTES: Final = 1 << 20  # encoding this takes milliseconds, which the event loop has not
_SLOW_BYTES: Final = {"png": 16 << 10, "zstd": 64 << 10}  # these take longer


class Outgoing(Protocol):
    """A message as a link sees it; ``ropeway.graph.Sample`` is one."""

    payload: bytes
    type: str
    stamp_ns: int
    origin: bytes
    seq: int
    relayed: bool

    def cached(self, key: object, make: Callable[[], Any]) -> Any:
        """See ``Sample.cached``."""


class StreamSender(Protocol):
    """Sends the streams of one connection; ``LinkSender`` does so."""

    connection: Connection
    fault_log: FaultLog
    dialect: Dialect
    outbox: Outbox[Any]
    channels: dict[int, Stream[Any]]
    recent: deque[tuple[Stream[Any], Any]] | None

    @property
    def records(self) -> bool:
        """Whether the peer takes records."""
        ...

    @property
    def second(self) -> bool:
        """Whether it sends on a second connection."""
        ...

    def put(self, queue: Queue[Any], item: Message, *, at_once: bool = False) -> None:
        """Let a message wait for its turn."""
        ...

    def send_alone(self, stream: Stream[Any], body: bytes) -> bool:
        """Send a small record at once where nothing waits and this turn of the event loop has sent nothing; return
        whether it did.
        """
        ...

    def add(self, stream: Stream[Any]) -> None:
        """Make a stream ready to go out."""
        ...

    def drop(self, stream: Stream[Any]) -> None:
        """Forget a stream; what waits of it is lost."""
        ...

    def wake(self) -> None:
        """See that what waits is sent in this turn of the event loop."""
        ...


class Placing(Protocol):
    """Chooses between two connections; ``Express`` does so."""

    def place(self, channel: Channel) -> None:
        """Choose the connection of a topic for messages such as the one that is about to wait."""
        ...


M = TypeVar("M", bound=Message)


class Stream(Generic[M]):
    """Sends what goes out on a link under one ``number``, in order: the messages of a topic, or operations.

    ``used`` is the encoding of the last message, ``ready`` the number of that of messages that go as they are. ``gone``
    is called with each message that has gone.
    """

    __slots__ = ("closed", "gone", "number", "queue", "ready", "sender", "sent", "sent_bytes", "topic", "used")

    def __init__(self, sender: StreamSender, number: int, topic: str, queue: Queue[M], used: str) -> None:
        self.sender, self.number, self.topic = sender, number, topic
        self.queue = queue
        self.queue.key = self
        self.used = used
        self.ready = wire_codec.ENCODING_NUMBERS.get(used, 0)
        self.sent = self.sent_bytes = 0
        self.gone: Callable[[M], None] | None = None
        self.closed = False

    def close(self) -> None:
        """Withdraw it; what waits is lost."""
        if not self.closed:
            self.closed = True
            self.sender.drop(self)

    def pick(self, item: M) -> str:
        """Return the encoding for this message."""
        return self.used

    def finished(self, item: M, size_bytes: int) -> None:
        """Count a message that has gone, as so many bytes."""
        self.sent += 1
        self.sent_bytes += size_bytes
        if self.gone is not None:
            self.gone(item)

    def failed(self, item: M, error: BaseException) -> None:
        """Count a message that cannot be encoded."""
        self.queue.lost[Lost.ENCODE] += 1
        self.sender.fault_log.note("message", self.topic, error)

    def fragments(self, item: M) -> int | None:
        """Return how many characters of a message's text go in one frame, ``None`` for all of them."""
        raise NotImplementedError

    def is_slow(self, item: M, encoding: str) -> bool:
        """Return whether a thread should encode a message."""
        raise NotImplementedError

    def frame(self, item: M, encoding: str) -> wire_codec.Frame:
        """Return the frame of a message for a plain peer. Raises ``TypesError``."""
        raise NotImplementedError

    def body(self, item: M, encoding: str) -> bytes:
        """Return the body of the record of a message. Raises ``TypesError``."""
        raise NotImplementedError


class Channel(Stream[Outgoing]):
    """A topic under the ``number`` that the client gave it; ``sender`` makes it."""

    __slots__ = ("asked", "chooser", "codec", "encoding", "express", "fragment_size", "large", "type")

    def __init__(
        self,
        sender: StreamSender,
        number: int,
        topic: str,
        type: str,
        encoding: str,
        queue: Queue[Outgoing],
        codec: MessageCodec | None,
    ) -> None:
        used = encoding
        if encoding == "auto":
            used = "cbor-raw" if sender.records else "none"
        super().__init__(sender, number, topic, queue, used)
        self.type = type
        self.encoding = encoding
        self.codec = codec
        self.chooser: EncodingChooser | None = None
        if encoding in ("auto", "zstd"):
            filters.prepare(type)
        if encoding == "auto" and sender.records:
            self.chooser = EncodingChooser(sender.connection.flow.model)
        if used == "cbor-raw":
            queue.ready_bytes = SMALL_BYTES if self.chooser is None else SMALLEST_PACKED_BYTES - 1
        self.fragment_size: int | None = None  # characters; longer texts go in fragments
        self.express: Placing | None = None  # where there may be a second connection
        self.large = False  # a message was too large for it
        self.asked = False  # the peer has given it this number, so it needs not hear of it first

    def put(self, sample: Outgoing) -> None:
        """Let a message wait for its turn."""
        if self.closed:
            self.queue.lost[Lost.UNSENT] += 1
            return
        express = self.express
        if express is not None:
            if len(sample.payload) > EXPRESS_BYTES:
                self.large = True
            if self.large == self.sender.second:
                express.place(self)
        self.sender.put(self.queue, sample)

    def pick(self, item: Outgoing) -> str:
        """Choose the encoding for this message."""
        if self.chooser is not None:
            lost = self.queue.lost
            self.used = self.chooser.choose(len(item.payload), self.sent, lost[Lost.REPLACED] + lost[Lost.OVERFLOW])
        return self.used

    def fragments(self, item: Outgoing) -> int | None:
        """See ``Stream.fragments``."""
        return self.fragment_size

    def is_slow(self, item: Outgoing, encoding: str) -> bool:
        """See ``Stream.is_slow``."""
        size = len(item.payload)
        if encoding in ("cbor-raw", "rawzip"):
            return False
        return size >= _SLOW_BYTES.get(encoding, _BIG_BYTES)

    def frame(self, item: Outgoing, encoding: str) -> wire_codec.Frame:
        """Return a plain ``publish``, which is made once however many peers get it. Raises ``TypesError``."""
        dialect = self.sender.dialect
        spelling = (self.codec.variant, self.codec.long_texts) if self.codec is not None else ""
        made: wire_codec.Frame = item.cached(
            ("frame", self.topic, encoding, dialect.name, spelling),
            lambda: ENCODING.timed(
                encoding,
                lambda: wire_codec.encode_publish(
                    self.topic, item.payload, self.codec, encoding, dialect=dialect, stamp_ns=item.stamp_ns
                ),
            ),
        )
        return made

    def body(self, item: Outgoing, encoding: str) -> bytes:
        """Return the body of a record, which is made once however many peers get it. Raises ``TypesError``."""
        if encoding == "cbor-raw":
            return item.payload

        def make() -> bytes:
            if encoding != "zstd":
                return wire_codec.encode_msg(encoding, item.payload, self.codec, stamp_ns=item.stamp_ns)
            began = time.thread_time()  # others on the processor are no cost of compressing
            packed = filters.encode(item.payload, self.type)
            if self.chooser is not None:
                self.chooser.measured(len(item.payload), len(packed), time.thread_time() - began)
            return packed

        made: bytes = item.cached(("body", encoding), lambda: ENCODING.timed(encoding, make))
        return made
