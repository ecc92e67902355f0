"""Keeps the latest messages of a transient-local publisher for late joiners."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Final

from ropeway.graph.base import Sample
from ropeway.qos import QoS

__all__ = ["History"]

_LIMIT_BYTES: Final = 64 << 20  # above, the oldest go, whatever the depth; one message always stays


class History:
    """The newest messages of one topic, as deep and as old as its profile says; nothing where it is volatile."""

    __slots__ = ("_bytes", "_clock", "_depth", "_kept", "_lifespan_ns", "_limit_bytes")

    def __init__(self, qos: QoS, *, limit_bytes: int = _LIMIT_BYTES, clock: Callable[[], int] | None = None) -> None:
        if not qos.transient_local:
            self._depth: int | None = 0
        else:
            self._depth = None if qos.history == "keep_all" else max(qos.depth, 1)
        self._lifespan_ns = None if qos.lifespan_s is None else int(qos.lifespan_s * 1e9)
        self._limit_bytes = limit_bytes
        self._clock = clock
        self._kept: deque[Sample] | None = None  # most topics never have one
        self._bytes = 0

    def add(self, sample: Sample) -> None:
        """Keep a message."""
        if self._depth == 0:
            return
        kept = self._kept
        if kept is None:
            kept = self._kept = deque()
        kept.append(sample)
        self._bytes += len(sample.payload)
        while len(kept) > 1 and (self._bytes > self._limit_bytes or (self._depth and len(kept) > self._depth)):
            self._forget(kept)
        self._expire()

    def replay(self) -> list[Sample]:
        """Return the messages that a late joiner gets, oldest first."""
        self._expire()
        return list(self._kept or ())

    @property
    def bytes(self) -> int:
        """The size of all kept messages."""
        return self._bytes

    def _expire(self) -> None:
        kept = self._kept
        if self._lifespan_ns is None or not kept:
            return
        oldest = (time.time_ns() if self._clock is None else self._clock()) - self._lifespan_ns
        while kept and kept[0].stamp_ns < oldest:
            self._forget(kept)

    def _forget(self, kept: deque[Sample]) -> None:
        self._bytes -= len(kept.popleft().payload)
