"""ropeway.group.comparison: which of two was sooner with the same requests."""

from __future__ import annotations

from ropeway.group.comparison import Comparison
from ropeway.group.options import Options

LIMIT_S = 0.03


def compared(pairs: list[tuple[float | None, float | None]], *, hiccup: bool = False) -> Comparison:
    """Return a comparison in which both were asked at 0, and have answered as ``pairs`` says."""
    made = Comparison("b", hiccup)
    for key, took in enumerate(pairs):
        made.asked(key, 0.0)
        for name, took_s in zip("ab", took, strict=True):
            if took_s is not None:
                made.answered(key, name, took_s)
    return made


def test_two_late_in_a_row() -> None:
    """Two late requests of the one in use and one good answer of the rival are enough."""
    made = compared([(None, 0.01)])
    assert made.judge("a", 2, LIMIT_S, 0.02, Options()).beaten
    assert not made.judge("a", 1, LIMIT_S, 0.02, Options()).beaten


def test_a_rival_that_is_late_too() -> None:
    """A rival that is late for one of the same requests wins nothing by the other's lateness."""
    made = compared([(None, 0.05), (None, 0.01)])
    assert not made.judge("a", 5, LIMIT_S, 0.06, Options()).beaten


def test_late_more_often() -> None:
    """Of requests that neither has in time in a row, the rival must be late twice less often."""
    made = compared([(0.05, 0.01), (0.01, 0.05), (0.05, 0.01), (0.05, 0.01), (0.01, 0.01)])
    assert made.judge("a", 0, LIMIT_S, 1.0, Options()).beaten


def test_sooner_in_the_mean() -> None:
    """Where both are in time, the mean of many decides, by the margin."""
    few, many = compared([(0.02, 0.01)] * 8), compared([(0.02, 0.01)] * 16)
    assert not few.judge("a", 0, LIMIT_S, 1.0, Options()).beaten
    assert many.judge("a", 0, LIMIT_S, 1.0, Options()).beaten
    assert not compared([(0.02, 0.019)] * 16).judge("a", 0, LIMIT_S, 1.0, Options()).beaten


def test_one_good_answer_ends_a_hiccup() -> None:
    """After a hiccup one answer in time shows that the one in use is sound; after a missed bound it takes more."""
    assert compared([(0.01, 0.01)], hiccup=True).judge("a", 0, LIMIT_S, 1.0, Options()).sound
    assert not compared([(0.01, 0.01)]).judge("a", 0, LIMIT_S, 1.0, Options()).sound


def test_an_answer_to_another_request() -> None:
    """Only what both were asked counts."""
    made = Comparison("b")
    made.answered("other", "a", 0.5)
    assert made.judge("a", 0, LIMIT_S, 1.0, Options()).pairs == 0
