"""Measures one topic from where it is published to where it arrives."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from ropeway.graph.base import Sample

__all__ = ["Snapshot", "Tally"]

_RECENT_NS: Final = 1_000_000_000
_KEPT: Final = 20_000  # delays that the summary is made of


@dataclass(frozen=True)
class Snapshot:
    """The last second of a flow, or a whole one."""

    rate_hz: float = 0.0
    delay_ms: float | None = None
    bandwidth_bps: float = 0.0


@dataclass
class Tally:
    """Counts what was sent and what arrived.

    ``header_ns`` takes a payload to the stamp that the sender put into its header.
    """

    topic: str
    type: str
    side: str
    header_ns: Callable[[bytes], int | None]
    sent: int = 0
    arrived: int = 0
    bytes: int = 0
    first_ns: int = 0
    last_ns: int = 0
    delays_ms: deque[float] = field(default_factory=lambda: deque(maxlen=_KEPT))
    _recent: deque[tuple[int, int, float | None]] = field(default_factory=lambda: deque(maxlen=_KEPT))

    def on_sent(self, count: int) -> None:
        """Take the number of messages that the sender has sent."""
        self.sent = count

    def on_batch(self, batch: Sequence[Sample]) -> None:
        """Count messages that have arrived."""
        for sample in batch:
            stamp_ns = self.header_ns(sample.payload)
            delay_ms = None if stamp_ns is None else (sample.stamp_ns - stamp_ns) / 1e6
            size = len(sample.payload)
            self.arrived += 1
            self.bytes += size
            self.first_ns = self.first_ns or sample.stamp_ns
            self.last_ns = sample.stamp_ns
            if delay_ms is not None:
                self.delays_ms.append(delay_ms)
            self._recent.append((sample.stamp_ns, size, delay_ms))

    def recent(self, now_ns: int | None = None) -> Snapshot:
        """Return the figures of the last second."""
        now = time.time_ns() if now_ns is None else now_ns
        while self._recent and self._recent[0][0] < now - _RECENT_NS:
            self._recent.popleft()
        delays = [delay for _, _, delay in self._recent if delay is not None]
        return Snapshot(
            rate_hz=float(len(self._recent)),
            delay_ms=sum(delays) / len(delays) if delays else None,
            bandwidth_bps=8.0 * sum(size for _, size, _ in self._recent),
        )

    def summary(self) -> dict[str, Any]:
        """Return the figures of the whole flow, as JSON."""
        seconds = (self.last_ns - self.first_ns) / 1e9
        ordered = sorted(self.delays_ms)

        def quantile(share: float) -> float | None:
            return round(ordered[min(int(len(ordered) * share), len(ordered) - 1)], 3) if ordered else None

        return {
            "topic": self.topic,
            "type": self.type,
            "from": self.side,
            "sent": self.sent,
            "arrived": self.arrived,
            "rate_hz": round((self.arrived - 1) / seconds, 2) if seconds > 0 else 0.0,
            "delay_ms_p50": quantile(0.5),
            "delay_ms_p99": quantile(0.99),
            "bandwidth_bps": round(8 * self.bytes / seconds) if seconds > 0 else 0,
        }
