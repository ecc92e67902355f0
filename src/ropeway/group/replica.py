"""Keeps what a scheduler knows of one member. Sans-I/O."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from ropeway.group.bound import LatencyBound, Standing
from ropeway.group.latency import LatencyWindow, Statistics
from ropeway.group.options import Options

__all__ = ["Rank", "Replica"]

Rank = tuple[int, float, float]
"""Orders members, the most promising first: the standing, the mean with its requests in flight, and its penalty."""

_MOST_PENALTY_S: Final = 300.0
_IN_A_ROW: Final = 2  # requests without an answer: one may have been lost, or passed over
_WORSE: Final = 1.085  # times: of a long profile, what differs by less may be chance
_TOGETHER: Final = 3  # standard deviations
_ERRORS: Final = 2  # standard errors of a mean: nineteen of twenty are within
_ORDER: Final = (Standing.MET, Standing.UNKNOWN, Standing.MISSED)


@dataclass(slots=True, eq=False)
class Replica:
    """A member, its latencies, and what it has lost."""

    name: str
    window: LatencyWindow
    results: LatencyWindow = field(default_factory=LatencyWindow)  # of its goals, until their ends
    here: bool = False
    late: int = 0  # answers above the limit, one after the other
    penalty_s: float = 0.0
    alone_until_s: float = 0.0
    lost_at_s: float = float("-inf")
    known_s: float | None = None  # the mean when it was asked last, which outlives its window
    known_at_s: float = float("-inf")
    unsure_s: float = 0.0  # by how much that mean may be chance
    spread_s: float = 0.0  # the standard deviation then
    worst_s: float = 0.0  # the mean of the worst third then

    def late_in_a_row(self, now_s: float, limit_s: float | None) -> int:
        """Return how many requests in a row took longer than the limit, those without an answer included."""
        return 0 if limit_s is None else self.late + self.window.overdue(now_s, limit_s)

    def was(self, latency_s: float, limit_s: float | None) -> bool:
        """Note how long an answer took; return whether that is late."""
        if limit_s is None or latency_s <= limit_s:
            self.late = 0
            return False
        self.late += 1
        return True

    def rank(self, bound: LatencyBound, now_s: float) -> Rank:
        """Return how promising it is.

        Requests in flight count beside latency: who still owes answers is slower than the answers that came. The mean
        and not the median, because a machine that is slow every second time has a median that is chance.
        """
        found = self.window.statistics(now_s)
        mean_s = self.known_s if found is None else found.mean
        return _ORDER.index(bound.judge(found)), (mean_s or 0.0) * (1 + self.window.in_flight), self.alone_until_s

    def remember(self, now_s: float) -> Statistics | None:
        """Keep the mean for the time when the window is empty; return what the window holds."""
        found = self.window.statistics(now_s)
        if found is not None:
            self.known_s, self.known_at_s = found.mean, now_s
            self.spread_s, self.worst_s = found.stddev, found.worst_s
            self.unsure_s = _ERRORS * found.error_s
        return found

    def recalled(self, now_s: float, options: Options) -> float | None:
        """Return the mean, ``None`` if nobody has asked it for so long that it may be another one now."""
        found = self.window.statistics(now_s)
        if found is not None:
            return found.mean
        return self.known_s if now_s - self.known_at_s <= options.forgive_s else None

    def may_take_s(self, now_s: float, options: Options) -> float | None:
        """Return the least mean that it may have, after what was seen of it when it was asked last."""
        known_s = self.recalled(now_s, options)
        return None if known_s is None else known_s - self.unsure_s

    def was_in_time(self, now_s: float, limit_s: float, options: Options) -> bool:
        """Return whether it usually was in time when it was asked last, and has lost nothing since."""
        known_s = self.recalled(now_s, options)
        return known_s is not None and known_s + self.spread_s <= limit_s and self.alone_until_s <= now_s

    def fell_silent(self, now_s: float, limit_s: float, usual_s: float) -> bool:
        """Return whether two requests in a row have no answer: one late, and one older than half the answers took."""
        waiting = self.window.overdue(now_s, min(usual_s, limit_s))
        return waiting >= _IN_A_ROW and self.window.overdue(now_s, limit_s) > 0

    def is_worse_at_worst(self, other: Replica, limit_s: float | None) -> bool:
        """Return whether its worst was clearly worse than another's in a profile of both, which was late as well."""
        if limit_s is None or other.worst_s <= limit_s or self.known_at_s != other.known_at_s:
            return False
        return self.worst_s > other.worst_s * _WORSE

    def risen_s(self, now_mean_s: float, other: Replica) -> float:
        """Return by how much more requests take now than when ``other`` was asked as well, as far as they all may.

        Latencies rise and fall together, within what they varied by then; what is more is this member's own.
        """
        if self.known_s is None or self.known_at_s != other.known_at_s:
            return 0.0
        return min(max(now_mean_s - self.known_s, 0.0), _TOGETHER * self.spread_s)

    def lost(self, now_s: float, options: Options) -> None:
        """Leave it alone for a while, which doubles with each loss."""
        forgiven = now_s - self.lost_at_s > options.forgive_s
        self.penalty_s = options.penalty_s if forgiven else min(2 * self.penalty_s, _MOST_PENALTY_S)
        self.lost_at_s, self.alone_until_s = now_s, now_s + self.penalty_s

    def numbers(self, now_s: float) -> str:
        """Return its latency in words, for the log."""
        found = self.window.statistics(now_s)
        if found is None:
            return "nothing is known of it"
        return f"mean {1e3 * found.mean:.1f} ms, median {1e3 * found.median:.1f} ms, {found.answered} answers"
