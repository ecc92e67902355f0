"""The sliding figures of ``hz``, ``bw`` and ``delay``, and how ``ros2`` writes them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

from ropeway.graph.base import Sample

__all__ = ["Bandwidth", "Delay", "MeterReading", "Rate", "Spread", "TopicMeter"]


@dataclass(frozen=True, slots=True)
class MeterReading:
    """The reading of a meter: for people and for programs."""

    text: str
    json: dict[str, Any]


class TopicMeter(Protocol):
    """Counts messages and computes a figure about them."""

    def add(self, sample: Sample) -> None:
        """Count a message."""

    def read(self) -> MeterReading | None:
        """Return the figure now; ``None`` if there is nothing (new) to report."""


@dataclass(frozen=True, slots=True)
class Spread:
    """The mean, minimum, maximum and standard deviation of a series."""

    mean: float
    min: float
    max: float
    std_dev: float
    count: int

    @classmethod
    def of(cls, values: list[float]) -> Spread:
        """Compute the figures of at least one value."""
        mean = math.fsum(values) / len(values)
        variance = math.fsum((value - mean) ** 2 for value in values) / len(values)
        return cls(mean, min(values), max(values), math.sqrt(variance), len(values))

    def json(self, unit: str) -> dict[str, Any]:
        """Return the figures under keys with their unit."""
        return {
            f"mean_{unit}": self.mean,
            f"min_{unit}": self.min,
            f"max_{unit}": self.max,
            f"std_dev_{unit}": self.std_dev,
            "window": self.count,
        }

    def _line(self) -> str:
        spread = f"min: {self.min:.3f}s max: {self.max:.3f}s std dev: {self.std_dev:.5f}s"
        return f"\n\t{spread} window: {self.count}"


class Rate:
    """Measures how often messages come. ``window`` is how many of the newest intervals count."""

    def __init__(self, window: int = 10_000) -> None:
        self._stamps_ns: deque[int] = deque(maxlen=max(window, 1) + 1)
        self._fresh = False

    def add(self, sample: Sample) -> None:
        """Count a message by the time it was received."""
        if self._stamps_ns and sample.stamp_ns < self._stamps_ns[-1]:
            self._stamps_ns.clear()  # the clock was set back
        self._stamps_ns.append(sample.stamp_ns)
        self._fresh = True

    def read(self) -> MeterReading | None:
        """Return the rate and the intervals; ``None`` if nothing came since the last call."""
        if not self._fresh or len(self._stamps_ns) < 2:
            return None
        self._fresh = False
        spread = Spread.of([(b - a) / 1e9 for a, b in pairwise(self._stamps_ns)])
        rate_hz = 1.0 / spread.mean if spread.mean > 0 else math.inf
        return MeterReading(f"average rate: {rate_hz:.3f}{spread._line()}", {"rate_hz": rate_hz, **spread.json("s")})


class Bandwidth:
    """Measures how many bytes come per second. ``window`` is how many of the newest messages count."""

    def __init__(self, window: int, clock_ns: Callable[[], int]) -> None:
        self._seen: deque[tuple[int, int]] = deque(maxlen=max(window, 2))
        self._clock_ns = clock_ns

    def add(self, sample: Sample) -> None:
        """Count a message by the time it was received."""
        self._seen.append((sample.stamp_ns, len(sample.payload)))

    def read(self) -> MeterReading | None:
        """Return bytes per second until now and the sizes, all in the unit of the rate; ``None`` before the second
        message.
        """
        now_ns = self._clock_ns()
        if len(self._seen) < 2 or now_ns <= self._seen[0][0]:
            return None
        sizes = Spread.of([float(size) for _, size in self._seen])
        rate_bps = sizes.mean * sizes.count * 1e9 / (now_ns - self._seen[0][0])
        factor, unit = (1e6, "MB") if rate_bps >= 1e6 else (1e3, "KB") if rate_bps >= 1e3 else (1.0, "B")
        digits = 0 if unit == "B" else 2

        def show(value: float) -> str:
            return f"{value / factor:.{digits}f} {unit}"

        return MeterReading(
            f"{show(rate_bps)}/s from {sizes.count} messages\n"
            f"\tMessage size mean: {show(sizes.mean)} min: {show(sizes.min)} max: {show(sizes.max)}",
            {"bandwidth_Bps": rate_bps, **sizes.json("bytes")},
        )


class Delay:
    """Measures how old messages are when they come, by the stamp in their header.

    ``header_ns`` takes a payload to that stamp in nanoseconds.
    """

    def __init__(self, window: int, header_ns: Callable[[bytes], int | None]) -> None:
        self._seconds: deque[float] = deque(maxlen=max(window, 1))
        self._header_ns = header_ns
        self._fresh = False

    def add(self, sample: Sample) -> None:
        """Count a message; one without a stamp does not count."""
        stamp_ns = self._header_ns(sample.payload)
        if stamp_ns is not None:
            self._seconds.append((sample.stamp_ns - stamp_ns) / 1e9)
            self._fresh = True

    def read(self) -> MeterReading | None:
        """Return the delays; ``None`` if nothing came since the last call."""
        if not self._fresh:
            return None
        self._fresh = False
        spread = Spread.of(list(self._seconds))
        return MeterReading(f"average delay: {spread.mean:.3f}{spread._line()}", spread.json("s"))
