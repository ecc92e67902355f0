"""Counts durations by how long they were, so that metrics can tell the slow ones from the mean."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, TypedDict

__all__ = ["BOUNDS_NS", "BOUNDS_S", "Histogram", "HistogramJson", "added"]

BOUNDS_S: Final = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0)
"""The upper ends of the classes: from a cable between two machines to a satellite link that stalls. Few, since each
is a line of metrics per route."""

BOUNDS_NS: Final = tuple(round(bound_s * 1e9) for bound_s in BOUNDS_S)
"""The same, for what counts durations without a call for each; see ``Histogram.begun``."""


class HistogramJson(TypedDict):
    """A histogram as JSON: ``counts`` for each of ``BOUNDS_S``, and one for what took longer."""

    counts: Sequence[int]
    sum_s: float


class Histogram:
    """Counts durations in classes. One that is negative, as of clocks that differ, counts as none at all."""

    __slots__ = ("counts", "sum_ns")

    def __init__(self) -> None:
        self.counts: list[int] = []  # made with the first: most routes never have one
        self.sum_ns = 0

    def begun(self) -> list[int]:
        """Return ``counts`` with a place for each of ``BOUNDS_NS``, and one for what is longer."""
        if not self.counts:
            self.counts += [0] * (len(BOUNDS_NS) + 1)
        return self.counts

    def add(self, duration_ns: int) -> None:
        """Count a duration."""
        (self.counts or self.begun())[bisect_left(BOUNDS_NS, duration_ns)] += 1
        if duration_ns > 0:
            self.sum_ns += duration_ns

    def to_json(self) -> HistogramJson | None:
        """Return the histogram as JSON, ``None`` before the first duration."""
        return {"counts": list(self.counts), "sum_s": round(self.sum_ns / 1e9, 6)} if self.counts else None


def added(many: Iterable[Mapping[str, HistogramJson]]) -> dict[str, HistogramJson]:
    """Add up the histograms of several processes by their names."""
    sums: dict[str, HistogramJson] = {}
    for one in many:
        for name, histogram in one.items():
            so_far = sums.get(name)
            sums[name] = histogram if so_far is None else _sum(so_far, histogram)
    return sums


def _sum(one: HistogramJson, other: HistogramJson) -> HistogramJson:
    counts = [a + b for a, b in zip(one["counts"], other["counts"], strict=True)]
    return {"counts": counts, "sum_s": round(one["sum_s"] + other["sum_s"], 6)}
