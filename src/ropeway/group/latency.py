"""Latencies of one member over the last seconds, with what is known of requests that have no answer yet. Sans-I/O."""

from __future__ import annotations

import math
import statistics
from bisect import bisect_left
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass
from itertools import islice
from typing import Final

__all__ = ["LatencyWindow", "Statistics"]

WINDOW_S: Final = 3.0
"""How far back a window looks unless configured: ``latency_window`` of FogROS2-LS."""

_MOST: Final = 2048  # latencies in a window, of the newest: 90 frames a second for 22 s
_THIRD: Final = 3
_MOST_PENDING: Final = 1024  # requests without an answer that are remembered
_ENOUGH_OVERDUE: Final = 8  # more late requests in a row than that say nothing new
_GIVE_UP_WINDOWS: Final = 10  # a request that is older than so many windows is forgotten: nobody waits for it


@dataclass(frozen=True, slots=True)
class Statistics:
    """Summarises what a window holds, in seconds.

    ``answered`` requests count with their latency, ``pending`` ones with their age: they take at least that long.
    ``values`` are all of them, in order of size.
    """

    answered: int
    pending: int
    values: tuple[float, ...]

    @property
    def min(self) -> float:
        """Return the smallest."""
        return self.values[0]

    @property
    def max(self) -> float:
        """Return the largest."""
        return self.values[-1]

    @property
    def mean(self) -> float:
        """Return the mean."""
        return statistics.fmean(self.values)

    @property
    def median(self) -> float:
        """Return the median."""
        return statistics.median(self.values)

    @property
    def stddev(self) -> float:
        """Return the standard deviation of the population, as the thesis uses it; 0 for a single value."""
        mean = self.mean
        return math.sqrt(statistics.fmean((value - mean) ** 2 for value in self.values))

    @property
    def error_s(self) -> float:
        """Return the standard error of the mean."""
        return self.stddev / math.sqrt(len(self.values))

    def percentile(self, percent: float) -> float:
        """Return the smallest value that ``percent`` of all do not exceed."""
        return self.values[max(0, math.ceil(len(self.values) * percent / 100) - 1)]

    @property
    def worst_s(self) -> float:
        """Return the mean of the worst third: of few values a percentile is chance."""
        return statistics.fmean(self.values[-max(1, len(self.values) // _THIRD) :])

    def as_json(self) -> dict[str, float | int]:
        """Return the numbers that people look at, in seconds."""
        named = {name: round(getattr(self, name), 6) for name in ("min", "median", "mean", "max", "stddev")}
        return {"answered": self.answered, "pending": self.pending, **named, "p99": round(self.percentile(99), 6)}


class LatencyWindow:
    """The latencies of one member within the last ``window_s`` seconds.

    Times are those of a steady clock. The window ages by that clock, not by what comes: a member that has fallen silent
    does not keep its good name, and an empty window means that nothing is known. A latency is put in order of size when
    somebody asks for statistics, together with all that came since the last time: noting one costs next to nothing.
    """

    def __init__(self, window_s: float = WINDOW_S) -> None:
        self.window_s = window_s
        self._latencies: deque[tuple[float, float]] = deque()  # when it was known, and how long it took
        self._ordered: list[float] = []  # the oldest of them, by size
        self._pending: dict[Hashable, float] = {}  # when it was asked, oldest first
        self._answered_from_s = float("-inf")  # when the newest request that has an answer was asked

    def asked(self, now_s: float, key: Hashable) -> None:
        """Note a request that was sent. ``key`` tells it from others."""
        if len(self._pending) >= _MOST_PENDING:
            self.gave_up(now_s, next(iter(self._pending)))
        self._pending.setdefault(key, now_s)

    def answered(self, now_s: float, key: Hashable) -> float | None:
        """Return how long the answer to ``key`` took, ``None`` for an answer to no request that is known."""
        asked_s = self._pending.pop(key, None)
        if asked_s is None:
            return None
        if asked_s > self._answered_from_s:
            self._answered_from_s = asked_s
        took_s = now_s - asked_s
        self._latencies.append((now_s, took_s))
        if len(self._latencies) > _MOST:
            self._drop_oldest()
        return took_s

    def gave_up(self, now_s: float, key: Hashable) -> None:
        """Note that nobody waits for the answer to ``key`` any more: it took at least until now."""
        self.answered(now_s, key)

    def forget(self, key: Hashable) -> None:
        """Take back a request that says nothing of the member: it was refused before it was carried out."""
        self._pending.pop(key, None)

    def add(self, now_s: float, latency_s: float) -> None:
        """Note a latency that was measured elsewhere."""
        self._latencies.append((now_s, max(0.0, latency_s)))
        if len(self._latencies) > _MOST:
            self._drop_oldest()

    def clear(self) -> None:
        """Forget everything: the member is another one now."""
        self._latencies.clear()
        self._ordered.clear()
        self._pending.clear()

    @property
    def in_flight(self) -> int:
        """Return how many requests wait for an answer."""
        return len(self._pending)

    def overdue(self, now_s: float, limit_s: float) -> int:
        """Return how many requests since the last one that was answered have waited longer than that, up to a few.

        An older one may have been passed over: a detector that is slower than its camera takes the newest picture.
        """
        found = 0
        for asked_s in reversed(self._pending.values()):
            if asked_s <= self._answered_from_s or found == _ENOUGH_OVERDUE:
                break
            found += now_s - asked_s > limit_s
        return found

    def next_late_s(self, now_s: float, limit_s: float) -> float:
        """Return when one more request is late that came after all that were answered, infinity without one."""
        found = float("inf")
        for asked_s in reversed(self._pending.values()):
            if asked_s <= self._answered_from_s or asked_s + limit_s <= now_s:
                break
            found = asked_s + limit_s
        return found

    def recent_s(self, count: int) -> float | None:
        """Return the mean of the last ``count`` latencies, ``None`` without any."""
        last = list(islice(reversed(self._latencies), count))
        return statistics.fmean(latency_s for _, latency_s in last) if last else None

    def waits_since_s(self) -> float:
        """Return when the oldest request was asked that came after all that were answered, infinity without one."""
        found = float("inf")
        for asked_s in reversed(self._pending.values()):
            if asked_s <= self._answered_from_s:
                break
            found = asked_s
        return found

    def statistics(self, now_s: float) -> Statistics | None:
        """Return what the window holds, ``None`` while nothing is known.

        A request without an answer counts as soon as it is older than half of the answers took: a younger one says
        nothing yet. Where nothing was answered, all of them count.
        """
        if not self._latencies and not self._pending:
            return None
        self._age(now_s)
        answered = self._ordered
        if len(answered) < len(self._latencies):
            answered.extend(latency_s for _, latency_s in islice(self._latencies, len(answered), None))
            answered.sort()  # what is in order already is merged with the rest
        ages = [now_s - asked_s for asked_s in self._pending.values()]
        if answered:
            usual_s = answered[(len(answered) - 1) // 2]
            ages = [age for age in ages if age > usual_s]
        if not answered and not ages:
            return None
        return Statistics(len(answered), len(ages), tuple(sorted([*answered, *ages]) if ages else answered))

    def _age(self, now_s: float) -> None:
        while self._latencies and self._latencies[0][0] <= now_s - self.window_s:
            self._drop_oldest()
        forgotten_s = now_s - _GIVE_UP_WINDOWS * self.window_s
        for key in [key for key, asked_s in self._pending.items() if asked_s <= forgotten_s]:
            del self._pending[key]

    def _drop_oldest(self) -> None:
        _, latency_s = self._latencies.popleft()
        if self._ordered:  # else nobody has asked since it came
            del self._ordered[bisect_left(self._ordered, latency_s)]
