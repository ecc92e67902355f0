"""Measures topics for a plan: the size and rate of their messages, and how far each encoding compresses them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from ropeway.networks.rosbridge.protocol import codec
from ropeway.planning.plan import PlannedTopic
from ropeway.types.codec import MessageCodec

__all__ = ["ENCODINGS", "SAMPLED_MESSAGES", "TopicSampler", "compression_ratios"]

ENCODINGS: Final = ("none", "cbor", "cbor-raw", "zip", "rawzip", "zstd")
SAMPLED_MESSAGES: Final = 10
"""How many messages of a topic are compressed to find the ratios: enough for images that are alike."""
_SAMPLED_BYTES: Final = 64 << 20  # what samples of one topic may hold in memory


def compression_ratios(message_codec: MessageCodec, payloads: Sequence[bytes]) -> dict[str, float]:
    """Return the ratio of every encoding over at least one message: CDR bytes by bytes that travel."""
    raw = sum(map(len, payloads))
    return {
        encoding: raw / max(sum(len(codec.encode_msg(encoding, payload, message_codec)) for payload in payloads), 1)
        for encoding in ENCODINGS
    }


class TopicSampler:
    """Collects what a plan needs of one topic, message by message, in bounded memory.

    ``kept`` are the samples that will be compressed.
    """

    def __init__(self, name: str, type: str) -> None:
        self.name, self.type = name, type
        self.count = 0
        self._bytes = 0
        self._first_ns = self._last_ns = 0
        self._every = 1
        self.kept: list[bytes] = []
        self._kept_bytes = 0

    def add(self, stamp_ns: int, payload: bytes) -> None:
        """Count a message; every so many are kept for ``compression_ratios``, evenly over the time."""
        if not self.count:
            self._first_ns = stamp_ns
        self._last_ns = max(self._last_ns, stamp_ns)
        if self.count % self._every == 0 and (not self.kept or self._kept_bytes + len(payload) <= _SAMPLED_BYTES):
            self.kept.append(bytes(payload))
            self._kept_bytes += len(payload)
            if len(self.kept) >= 2 * SAMPLED_MESSAGES:
                self.kept = self.kept[::2]
                self._kept_bytes = sum(map(len, self.kept))
                self._every *= 2
        self.count += 1
        self._bytes += len(payload)

    def topic(
        self, message_codec: MessageCodec | None, publishers: dict[str, int], readers: dict[str, int]
    ) -> PlannedTopic | None:
        """Return the topic as measured; ``None`` before the second message, which its rate needs.

        The rate is that of all messages, so ``publishers`` says how they are spread. Without a codec the ratios are
        unknown.
        """
        seconds = (self._last_ns - self._first_ns) / 1e9
        if self.count < 2 or seconds <= 0:
            return None
        rate_hz = (self.count - 1) / seconds
        return PlannedTopic(
            name=self.name,
            size_bytes=self._bytes / self.count,
            published_hz=rate_hz / max(sum(publishers.values()), 1),
            publishers=publishers,
            readers=readers,
            type=self.type,
            ratios={} if message_codec is None else compression_ratios(message_codec, self.kept),
        )
