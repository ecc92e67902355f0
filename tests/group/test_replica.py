"""ropeway.group.replica: what is known of one member."""

from __future__ import annotations

import pytest

from ropeway.group.bound import LatencyBound
from ropeway.group.latency import LatencyWindow
from ropeway.group.options import Options
from ropeway.group.replica import Replica

OPTIONS = Options()


def replica(*latencies: float) -> Replica:
    """Return a member that has answered with these latencies at 0."""
    made = Replica("a", LatencyWindow(), here=True)
    for latency_s in latencies:
        made.window.add(0.0, latency_s)
    return made


def test_what_is_known_outlives_the_window() -> None:
    """The mean is remembered when the window is empty, and forgotten when nobody has asked for a minute."""
    made = replica(0.01, 0.03)
    made.remember(1.0)
    assert made.recalled(1.0, OPTIONS) == pytest.approx(0.02)
    assert made.recalled(30.0, OPTIONS) == pytest.approx(0.02)
    assert made.recalled(62.0, OPTIONS) is None
    assert made.may_take_s(62.0, OPTIONS) is None


def test_few_answers_may_be_chance() -> None:
    """What a member may take at best is its mean less two standard errors, so that few answers say little."""
    few, many = replica(*[0.01, 0.03] * 2), replica(*[0.01, 0.03] * 50)
    for made in (few, many):
        made.remember(0.0)
    assert few.may_take_s(0.0, OPTIONS) == pytest.approx(0.01)
    assert many.may_take_s(0.0, OPTIONS) == pytest.approx(0.018)


def test_the_penalty_doubles() -> None:
    """Each loss doubles the time in which it is left alone, up to five minutes; a minute without one forgives."""
    made = replica()
    penalties = []
    for now_s in (0.0, 10.0, 20.0, 30.0):
        made.lost(now_s, OPTIONS)
        penalties.append(made.alone_until_s - now_s)
    assert penalties == [2.0, 4.0, 8.0, 16.0]
    made.lost(200.0, OPTIONS)
    assert made.alone_until_s == 202.0


def test_late_in_a_row() -> None:
    """Late answers and requests that are overdue count together; one answer in time ends the row."""
    made = replica()
    made.was(0.05, 0.03)
    made.window.asked(1.0, "open")
    assert made.late_in_a_row(1.02, 0.03) == 1
    assert made.late_in_a_row(1.04, 0.03) == 2
    made.was(0.01, 0.03)
    assert made.late_in_a_row(1.02, 0.03) == 0
    assert made.late_in_a_row(1.04, None) == 0


def test_rank() -> None:
    """A member that meets the bound comes before one of which nothing is known, and that before one that misses it."""
    bound = LatencyBound.of({"median": 0.02})
    met, unknown, missed = replica(0.01), replica(), replica(0.03)
    assert met.rank(bound, 0.0) < unknown.rank(bound, 0.0) < missed.rank(bound, 0.0)
    assert unknown.numbers(0.0) == "nothing is known of it"
    assert "mean 10.0 ms" in met.numbers(0.0)


def test_what_rises_for_all() -> None:
    """What requests take more than when two members were asked together may be so for both, within what it varied."""
    made, other = replica(0.02, 0.04), replica(0.03)
    for member in (made, other):
        member.remember(1.0)
    assert made.risen_s(0.03, other) == 0.0
    assert made.risen_s(0.04, other) == pytest.approx(0.01)
    assert made.risen_s(0.5, other) == pytest.approx(0.03)
    other.remember(2.0)
    assert made.risen_s(0.04, other) == 0.0
