"""Holds the first messages of a topic until there is somebody to give them to."""

from __future__ import annotations

from collections import Counter, deque
from typing import Final

from ropeway.delivery.outbox import Lost
from ropeway.delivery.pipeline import Reason
from ropeway.graph.base import Sample

__all__ = ["EARLY_BYTES", "EarlyQueue"]

EARLY_BYTES: Final = 16 << 20
"""The bytes that may wait while a publisher is being made; a single message may be larger."""


class EarlyQueue:
    """Holds messages, as a step, until ``take``; the oldest make room and are counted in ``drops``."""

    __slots__ = ("_drops", "_limit_bytes", "_waiting", "bytes")

    def __init__(self, drops: Counter[Reason], *, limit_bytes: int = EARLY_BYTES) -> None:
        self.bytes = 0
        self._drops, self._limit_bytes = drops, limit_bytes
        self._waiting: deque[Sample] | None = None  # an empty deque of each topic takes 0.6 kB

    def hold(self, sample: Sample) -> None:
        """Hold a message."""
        waiting = self._waiting
        if waiting is None:
            waiting = self._waiting = deque()
        waiting.append(sample)
        self.bytes += len(sample.payload)
        while self.bytes > self._limit_bytes and len(waiting) > 1:
            self.bytes -= len(waiting.popleft().payload)
            self._drops[Lost.OVERFLOW] += 1

    def take(self) -> list[Sample]:
        """Return what was held, oldest first, and hold nothing any more."""
        waiting, self._waiting = self._waiting, None
        self.bytes = 0
        return list(waiting or ())
