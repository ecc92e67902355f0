"""The latency that an application asks for. Sans-I/O."""

from __future__ import annotations

import enum
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from ropeway.group.latency import Statistics

__all__ = ["STATISTICS", "LatencyBound", "Standing"]

STATISTICS: Final = ("max", "mean", "median", "min", "stddev")
"""The statistics of FogROS2-LS (thesis, Listing 1) that can be bounded from above; percentiles are written p99."""

_PERCENTILE: Final = re.compile(r"p(\d{1,2}(?:\.\d+)?)")


class Standing(enum.Enum):
    """The standing of a member against a bound."""

    MET = "met"
    MISSED = "missed"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class LatencyBound:
    """Sets upper bounds in seconds on statistics of a latency window; a statistic without a bound is ignored.

    ``limits`` has them by name: ``max``, ``mean``, ``median``, ``min``, ``stddev``, or a percentile such as ``p99``.
    """

    limits: tuple[tuple[str, float], ...] = ()

    @classmethod
    def of(cls, limits: Mapping[str, float]) -> LatencyBound:
        """Return the bound that ``limits`` names. Raises ``ValueError`` for a statistic that there is not."""
        for name in limits:
            if name not in STATISTICS and not _PERCENTILE.fullmatch(name):
                raise ValueError(f'"{name}" is not a statistic of latencies; known are {", ".join(STATISTICS)} and p99')
        return cls(tuple(limits.items()))

    @property
    def limit_s(self) -> float | None:
        """Return what a single request may take before it counts as late, ``None`` without a bound.

        That is the loosest bound on a quantile or the mean: a request above it makes the window worse, whichever is
        meant. A bound on the spread says nothing of one request.
        """
        return max((limit for name, limit in self.limits if name != "stddev"), default=None)

    def judge(self, found: Statistics | None) -> Standing:
        """Return whether ``found`` meets every bound; requests without an answer can only miss one."""
        if not self.limits:
            return Standing.MET
        if found is None:
            return Standing.UNKNOWN
        if any(_value(found, name) > limit for name, limit in self.limits):
            return Standing.MISSED
        return Standing.MET if found.answered else Standing.UNKNOWN

    def missed(self, found: Statistics) -> str:
        """Return which bounds ``found`` misses, with the numbers, for the log."""
        values = ((name, _value(found, name), limit) for name, limit in self.limits)
        return ", ".join(f"{name} {1e3 * v:.1f} ms > {1e3 * limit:.1f} ms" for name, v, limit in values if v > limit)


def _value(found: Statistics, name: str) -> float:
    percentile = _PERCENTILE.fullmatch(name)
    value: float = found.percentile(float(percentile[1])) if percentile else getattr(found, name)
    return value
