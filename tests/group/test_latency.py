"""ropeway.group.latency: windows that age by the clock."""

from __future__ import annotations

import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.group.latency import LatencyWindow


def test_nothing_is_known_of_an_empty_window() -> None:
    """A member of whom nothing was heard is unknown, not good."""
    assert LatencyWindow().statistics(100.0) is None


def test_statistics() -> None:
    """The numbers are those of Python's statistics module, and the percentile is one of the values."""
    window = LatencyWindow(10.0)
    latencies = [0.010, 0.030, 0.020, 0.050, 0.040]
    for i, latency in enumerate(latencies):
        window.add(float(i) / 10, latency)
    found = window.statistics(1.0)
    assert found is not None
    assert (found.min, found.median, found.max) == (0.010, 0.030, 0.050)
    assert found.mean == pytest.approx(statistics.fmean(latencies))
    assert found.stddev == pytest.approx(statistics.pstdev(latencies))
    assert found.error_s == pytest.approx(found.stddev / 5**0.5)
    assert window.recent_s(2) == pytest.approx(0.045)
    assert window.recent_s(9) == pytest.approx(0.030)
    assert LatencyWindow().recent_s(2) is None
    assert (found.percentile(20), found.percentile(21), found.percentile(100)) == (0.010, 0.020, 0.050)


def test_silence_does_not_keep_a_good_name() -> None:
    """Latencies leave the window as time passes, also when nothing new comes."""
    window = LatencyWindow(3.0)
    window.add(0.0, 0.01)
    assert window.statistics(2.9) is not None
    assert window.statistics(3.1) is None


def test_a_request_without_answer_counts_as_at_least_so_late() -> None:
    """A pending request is no latency at first, and a growing one once it is older than the usual answer."""
    window = LatencyWindow(3.0)
    for i in range(3):
        window.asked(i * 0.1, i)
        assert window.answered(i * 0.1 + 0.02, i) == pytest.approx(0.02)
    window.asked(1.0, "late")
    young, old = window.statistics(1.01), window.statistics(1.5)
    assert young is not None and old is not None
    assert (young.answered, young.pending) == (3, 0)
    assert old.pending == 1
    assert old.max == pytest.approx(0.5)


def test_only_pending_requests() -> None:
    """A member that has answered nothing yet is judged by how long it has been asked."""
    window = LatencyWindow(3.0)
    window.asked(0.0, 1)
    found = window.statistics(0.4)
    assert found is not None
    assert found.answered == 0
    assert found.min == pytest.approx(0.4)


def test_answers_to_nobody() -> None:
    """An answer to a request that is not known, or was answered, says nothing."""
    window = LatencyWindow()
    window.asked(0.0, 1)
    assert window.answered(0.1, 2) is None
    assert window.answered(0.1, 1) == pytest.approx(0.1)
    assert window.answered(0.2, 1) is None


def test_a_refused_request_says_nothing() -> None:
    """A request that was taken back leaves no trace."""
    window = LatencyWindow()
    window.asked(0.0, 1)
    window.forget(1)
    assert window.statistics(1.0) is None


def test_a_request_is_forgotten_one_day() -> None:
    """What nobody waits for any more does not count for ever."""
    window = LatencyWindow(1.0)
    window.asked(0.0, 1)
    assert window.statistics(9.9) is not None
    assert window.statistics(10.1) is None


def test_bounded() -> None:
    """However many requests are never answered, a bounded number is remembered, and the oldest count as late."""
    window = LatencyWindow(1e6)
    for i in range(10_000):
        window.asked(i * 0.001, i)
    found = window.statistics(10.0)
    assert found is not None
    assert len(found.values) <= 4096 + 1024


@given(st.lists(st.tuples(st.floats(0, 10), st.floats(0, 1)), max_size=60), st.floats(0.1, 5), st.floats(0, 20))
def test_every_value_is_of_the_window(events: list[tuple[float, float]], window_s: float, now_s: float) -> None:
    """Whatever was measured when, the window holds what is not older than itself, in order of size."""
    window = LatencyWindow(window_s)
    events = sorted(event for event in events if event[0] <= now_s)
    for at_s, latency_s in events:
        window.add(at_s, latency_s)
    expected = sorted(latency for at, latency in events if at > now_s - window_s)
    found = window.statistics(now_s)
    assert (list(found.values) if found is not None else []) == expected


def test_what_is_late_next() -> None:
    """Of requests that came after all that were answered, the first that is not late yet tells when one is."""
    window = LatencyWindow()
    for key in range(4):
        window.asked(0.01 * key, key)
    assert window.next_late_s(0.03, 0.05) == pytest.approx(0.05)
    assert window.next_late_s(0.055, 0.05) == pytest.approx(0.06)
    window.answered(0.056, 2)
    assert window.next_late_s(0.056, 0.05) == pytest.approx(0.08)
    assert window.next_late_s(0.09, 0.05) == float("inf")
