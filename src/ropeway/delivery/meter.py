"""Measures rate, bandwidth and delay of a topic, as tables and metrics show them."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ropeway.graph.base import Sample

__all__ = ["Meter"]


class Meter:
    """Measures rate, bandwidth and delay over the last seconds, at a cost per batch and not per message."""

    __slots__ = (
        "_at",
        "_bytes",
        "_delay_n",
        "_delay_ns",
        "_messages",
        "bytes",
        "delay_s",
        "messages",
        "rate_bps",
        "rate_hz",
    )

    def __init__(self) -> None:
        self.messages = self.bytes = 0
        self.rate_hz = self.rate_bps = 0.0
        self.delay_s: float | None = None
        self._at = time.monotonic()
        self._messages = self._bytes = 0
        self._delay_ns = self._delay_n = 0

    def add(self, sample: Sample, now_ns: int) -> None:
        """Count one message."""
        self.messages += 1
        self.bytes += len(sample.payload)
        if sample.sent_ns:
            self._delay_ns += now_ns - sample.sent_ns
            self._delay_n += 1

    def update(self) -> None:
        """Bring the rates up to date; call it about once a second."""
        now = time.monotonic()
        seconds = now - self._at
        if seconds < 0.2:
            return
        self.rate_hz = (self.messages - self._messages) / seconds
        self.rate_bps = 8 * (self.bytes - self._bytes) / seconds
        if self._delay_n:
            self.delay_s = self._delay_ns / self._delay_n / 1e9
        elif self.messages == self._messages:
            self.delay_s = None
        self._at, self._messages, self._bytes = now, self.messages, self.bytes
        self._delay_ns = self._delay_n = 0
