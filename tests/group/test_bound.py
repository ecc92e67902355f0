"""ropeway.group.bound: what an application asks for."""

from __future__ import annotations

import pytest

from ropeway.group.bound import LatencyBound, Standing
from ropeway.group.latency import Statistics

FAST = Statistics(4, 0, (0.01, 0.01, 0.02, 0.06))


@pytest.mark.parametrize(
    ("limits", "standing"),
    [
        ({}, Standing.MET),
        ({"median": 0.3}, Standing.MET),
        ({"max": 0.05}, Standing.MISSED),
        ({"max": 0.07, "mean": 0.02}, Standing.MISSED),
        ({"min": 0.005}, Standing.MISSED),
        ({"stddev": 0.1}, Standing.MET),
        ({"p75": 0.02}, Standing.MET),
        ({"p99": 0.05}, Standing.MISSED),
    ],
)
def test_each_statistic_is_bounded_from_above(limits: dict[str, float], standing: Standing) -> None:
    """A bound is met if no statistic that it names is larger; what it does not name is not looked at."""
    assert LatencyBound.of(limits).judge(FAST) is standing


def test_unknown() -> None:
    """Nothing known is neither met nor missed, and requests without an answer can only miss."""
    bound = LatencyBound.of({"median": 0.3})
    assert bound.judge(None) is Standing.UNKNOWN
    assert bound.judge(Statistics(0, 1, (0.1,))) is Standing.UNKNOWN
    assert bound.judge(Statistics(0, 1, (0.4,))) is Standing.MISSED


def test_says_what_is_missed() -> None:
    """The log gets every bound that is missed with both numbers."""
    bound = LatencyBound.of({"max": 0.05, "median": 0.3})
    assert bound.missed(FAST) == "max 60.0 ms > 50.0 ms"


def test_limit_of_one_request() -> None:
    """One request is late above the loosest bound on a size; a bound on the spread says nothing of it."""
    assert LatencyBound.of({"median": 0.03, "p99": 0.1, "stddev": 9.0}).limit_s == 0.1
    assert LatencyBound().limit_s is None


def test_no_such_statistic() -> None:
    """A name that is none is refused with those that there are."""
    with pytest.raises(ValueError, match="max, mean, median, min, stddev and p99"):
        LatencyBound.of({"average": 1.0})
