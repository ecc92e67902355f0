"""One topic that goes out on a link: what waits of it, and how it is encoded."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, Protocol

from ropeway.delivery.compression import filters
from ropeway.delivery.encoding_choice import EncodingChooser
from ropeway.delivery.outbox import Lost, Queue
from ropeway.networks.rosbridge.protocol import codec as wire_codec

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.link.express import Express
    from ropeway.networks.rosbridge.link.sender import LinkSender
    from ropeway.types import MessageCodec

__all__ = ["Channel", "Outgoing"]

_BIG_BYTES: Final = 1 << 20  # encoding this takes milliseconds, which the event loop has not
_SLOW_BYTES: Final = {"png": 16 << 10, "zstd": 64 << 10}  # these take longer


class Outgoing(Protocol):
    """What a link needs of a message that goes out; ``ropeway.graph.Sample`` has it."""

    payload: bytes
    type: str
    stamp_ns: int
    origin: bytes
    seq: int
    relayed: bool

    def cached(self, key: object, make: Callable[[], Any]) -> Any:
        """See ``Sample.cached``."""


class Channel:
    """A topic under the ``number`` that the client gave it; ``sender`` makes it."""

    __slots__ = (
        "chooser",
        "closed",
        "codec",
        "encoding",
        "express",
        "fragment_size",
        "large",
        "number",
        "queue",
        "sender",
        "sent",
        "sent_bytes",
        "topic",
        "type",
        "used",
    )

    def __init__(
        self,
        sender: LinkSender,
        number: int,
        topic: str,
        type: str,
        encoding: str,
        queue: Queue[Outgoing],
        codec: MessageCodec | None,
    ) -> None:
        self.sender, self.number, self.topic, self.type = sender, number, topic, type
        self.encoding = encoding
        self.queue = queue
        self.queue.key = self
        self.codec = codec
        self.chooser: EncodingChooser | None = None
        self.used = encoding  # by the last message
        if encoding == "auto":
            self.used = "cbor-raw" if sender.records else "none"
            if sender.records:
                self.chooser = EncodingChooser(sender.connection.flow.model)
        self.fragment_size: int | None = None  # characters; longer texts go in fragments
        self.sent = self.sent_bytes = 0
        self.closed = False
        self.express: Express | None = None  # where there may be a second connection
        self.large = False  # a message was too large for it

    def put(self, sample: Outgoing) -> None:
        """Let a message wait for its turn."""
        if self.closed:
            self.queue.lost[Lost.UNSENT] += 1
        else:
            if self.express is not None:
                self.express.place(self, len(sample.payload))
            self.sender.put(self, sample)

    def close(self) -> None:
        """Withdraw the topic; what waits is lost."""
        if not self.closed:
            self.closed = True
            self.sender.drop(self)

    def pick(self, sample: Outgoing) -> str:
        """The encoding for this message."""
        if self.chooser is not None:
            lost = self.queue.lost
            self.used = self.chooser.choose(len(sample.payload), self.sent, lost[Lost.REPLACED] + lost[Lost.OVERFLOW])
        return self.used

    def finished(self, sample: Outgoing, size_bytes: int) -> None:
        """A message has gone, as so many bytes."""
        self.sent += 1
        self.sent_bytes += size_bytes

    def failed(self, sample: Outgoing, error: BaseException) -> None:
        """Count a message that cannot be encoded."""
        self.queue.lost[Lost.ENCODE] += 1
        self.sender.fault_log.note("message", self.topic, error)

    def fragments(self, sample: Outgoing) -> int | None:
        """How many characters of a message's text go in one frame, ``None`` for all of them."""
        return self.fragment_size

    @staticmethod
    def is_slow(sample: Outgoing, encoding: str) -> bool:
        """True for a message that a thread should encode."""
        size = len(sample.payload)
        if encoding in ("cbor-raw", "rawzip"):
            return False
        return size >= _SLOW_BYTES.get(encoding, _BIG_BYTES)

    def frame(self, sample: Outgoing, encoding: str) -> wire_codec.Frame:
        """A plain ``publish``; made once however many peers get it. Raises ``TypesError``."""
        dialect = self.sender.dialect
        spelling = (self.codec.variant, self.codec.long_texts) if self.codec is not None else ""
        made: wire_codec.Frame = sample.cached(
            ("frame", self.topic, encoding, dialect.name, spelling),
            lambda: wire_codec.encode_publish(
                self.topic, sample.payload, self.codec, encoding, dialect=dialect, stamp_ns=sample.stamp_ns
            ),
        )
        return made

    def body(self, sample: Outgoing, encoding: str) -> bytes:
        """The body of a record; made once however many peers get it. Raises ``TypesError``."""
        if encoding == "cbor-raw":
            return sample.payload

        def make() -> bytes:
            if encoding != "zstd":
                return wire_codec.encode_msg(encoding, sample.payload, self.codec, stamp_ns=sample.stamp_ns)
            began = time.thread_time()  # others on the processor are no cost of compressing
            packed = filters.encode(sample.payload, self.type)
            if self.chooser is not None:
                self.chooser.measured(len(sample.payload), len(packed), time.thread_time() - began)
            return packed

        made: bytes = sample.cached(("body", encoding), make)
        return made
