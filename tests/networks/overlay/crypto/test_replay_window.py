"""Counters that came already."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ropeway.networks.overlay.crypto.replay_window import WINDOW, ReplayWindow
from ropeway.networks.overlay.refusal import Refusal


def test_each_once() -> None:
    """A number is taken once, in whatever order they come."""
    window = ReplayWindow()
    for number in (3, 1, 2):
        assert window.judge(number) is None
        window.take(number)
        assert window.judge(number) is Refusal.REPLAYED
    assert window.judge(4) is None


def test_batches() -> None:
    """A batch is refused where one of its numbers came before."""
    window = ReplayWindow()
    window.take(10, 5)
    assert window.judge(8, 3) is Refusal.REPLAYED
    assert window.judge(14, 4) is Refusal.REPLAYED
    assert window.judge(15, 4) is None
    assert window.judge(5, 5) is None


def test_too_old() -> None:
    """What is before the window, or before it began, is too old."""
    window = ReplayWindow(floor=100)
    assert window.judge(99) is Refusal.TOO_OLD
    window.take(100)
    window.take(100 + WINDOW)
    assert window.judge(100) is Refusal.TOO_OLD
    assert window.judge(101) is None


def test_a_leap() -> None:
    """A leap over everything costs neither time nor memory."""
    window = ReplayWindow()
    window.take(1)
    window.take(2**63)
    assert window.judge(2**63) is Refusal.REPLAYED
    assert window.judge(2**63 - 1) is None


@given(st.lists(st.tuples(st.integers(1, 200), st.integers(1, 20)), max_size=60))
def test_like_a_set(batches: list[tuple[int, int]]) -> None:
    """Within the window it decides as a set of all numbers would."""
    window, seen = ReplayWindow(), set[int]()
    for first, count in batches:
        numbers = set(range(first, first + count))
        assert (window.judge(first, count) is None) == (not numbers & seen)
        if not numbers & seen:
            window.take(first, count)
            seen |= numbers
