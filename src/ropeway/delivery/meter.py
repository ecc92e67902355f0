"""Measures rate, bandwidth and delay of a topic, as tables and metrics show them."""

from __future__ import annotations

import time

from ropeway.delivery.histogram import Histogram

__all__ = ["Meter"]


class Meter:
    """Measures rate, bandwidth and delay over the last seconds; a passage counts.

    ``delay_ns`` adds up how long ``delayed`` messages were on their way since the last update, ``delays`` has them all,
    and those of other meters that share it. ``passed_s`` is when an update found a message last, ``None`` before the
    first.
    """

    __slots__ = (
        "_at",
        "_bytes",
        "_messages",
        "bytes",
        "delay_ns",
        "delay_s",
        "delayed",
        "delays",
        "messages",
        "passed_s",
        "rate_bps",
        "rate_hz",
    )

    def __init__(self, delays: Histogram | None = None) -> None:
        self.messages = self.bytes = 0
        self.rate_hz = self.rate_bps = 0.0
        self.delay_s: float | None = None
        self.passed_s: float | None = None
        self._at = time.monotonic()
        self._messages = self._bytes = 0
        self.delay_ns = self.delayed = 0
        self.delays = Histogram() if delays is None else delays

    def update(self) -> None:
        """Bring the rates up to date; call it about once a second."""
        now = time.monotonic()
        seconds = now - self._at
        if seconds < 0.2:
            return
        self.rate_hz = (self.messages - self._messages) / seconds
        self.rate_bps = 8 * (self.bytes - self._bytes) / seconds
        if self.delayed:
            self.delay_s = self.delay_ns / self.delayed / 1e9
        elif self.messages == self._messages:
            self.delay_s = None
        if self.messages != self._messages:
            self.passed_s = now
        self._at, self._messages, self._bytes = now, self.messages, self.bytes
        self.delay_ns = self.delayed = 0
