"""The messages of one topic that come from a peer in records, as samples."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

from ropeway.delivery.compression import filters
from ropeway.errors import MessageTooBig, TypesError
from ropeway.graph.base import Sample
from ropeway.networks.rosbridge.protocol import codec as wire_codec

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.link.peer import Peer
    from ropeway.networks.rosbridge.protocol.records import Arrival
    from ropeway.types import MessageCodec

__all__ = ["Inbound"]

_NEED_NO_CODEC: Final = ("rawzip", "zstd")


class Inbound(ABC):
    """A topic that comes from a peer. ``used`` is the encoding of the last message, or what is asked for."""

    def __init__(self, type: str, peer: Peer | None, deliver: Callable[[Sequence[Sample]], None], *, used: str) -> None:
        self.type = type
        self.used = used
        self._peer = peer
        self._deliver = deliver
        filters.prepare(type)

    def arrived(self, arrivals: Sequence[Arrival]) -> None:
        """Deliver messages that came in records."""
        peer = self._peer
        if peer is None:
            return
        type, now_ns, offset_ns = self.type, time.time_ns(), peer.clock_offset_ns
        batch: list[Sample] = []
        for arrival in arrivals:
            _, encoding, payload, origin, seq, stamp_ns, relayed = arrival
            if encoding != wire_codec.CBOR_RAW:
                try:
                    name = wire_codec.encoding_name(encoding)
                    payload = peer.decode(arrival, None if name in _NEED_NO_CODEC else self.codec())
                except (TypesError, MessageTooBig) as error:
                    self.unreadable(error)
                    continue
            self.used = wire_codec.ENCODINGS[encoding]
            sent_ns = stamp_ns - offset_ns if stamp_ns and offset_ns is not None else 0
            batch.append(Sample(payload, type, now_ns, origin, seq, relayed, sent_ns))
        if not batch:
            return
        try:
            self._deliver(batch)
        except Exception:  # a callback is somebody else's code; the connection must not suffer
            self.undelivered(batch)

    @abstractmethod
    def codec(self) -> MessageCodec:
        """Return how to read the peer's messages. Raises ``UnknownType``."""

    @abstractmethod
    def unreadable(self, error: Exception) -> None:
        """Count a message that cannot be read."""

    @abstractmethod
    def undelivered(self, batch: Sequence[Sample]) -> None:
        """Count messages with which a callback failed; its error is being handled."""
