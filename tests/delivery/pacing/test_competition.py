"""Whose queue it is, and what we keep beside those who fill a link."""

from __future__ import annotations

import pytest

from ropeway.delivery.pacing.competition import Competition, Situation

PACE = 1e6


def situation(window: int, queue_s: float, now_s: float = 0.0, base_s: float = 0.02) -> Situation:
    """A link of 1 MB/s, seen with this window and this queue."""
    return Situation(now_s, window, 4096, PACE, base_s, queue_s, 0.005, 0.015)


def test_no_long_queue() -> None:
    """With the queue that we want, the usual law holds."""
    others = Competition()
    assert all(others.advise(situation(25_000, 0.005)) is None for _ in range(100))
    assert others.kept_bytes(0.0, 0.02) == 0


def test_a_queue_of_ours() -> None:
    """A long queue that is shorter with half of the window is ours: the usual law holds again."""
    others = Competition()
    advice = others.advise(situation(80_000, 0.06))
    assert advice is not None
    assert (advice.window_bytes, advice.base_s) == (40_000, None)
    assert others.tested
    assert others.advise(situation(40_000, 0.02)) is None
    assert not others.tested


def test_after_a_test() -> None:
    """Once a queue has proved to be ours, the window is what would have left the queue that we want, at once."""
    others = Competition()
    assert others.advise(situation(115_000, 0.025, base_s=0.1)) is not None
    advice = others.advise(situation(57_500, 0.001, base_s=0.1))
    assert advice is not None
    assert advice.window_bytes == pytest.approx(115_000 * 0.105 / 0.125)
    assert advice.base_s is None
    assert others.advise(situation(96_600, 0.005, base_s=0.1)) is None


def test_a_queue_of_others() -> None:
    """A long queue that stays as long is part of the path; half of the pace from before is kept for a while."""
    others = Competition()
    others.calm(PACE)
    others.advise(situation(80_000, 0.06))
    advice = others.advise(situation(40_000, 0.06))
    assert advice is not None
    assert advice.base_s is not None
    assert advice.base_s > 0.08
    assert advice.window_bytes == PACE * advice.base_s
    assert others.kept_bytes(1.0, 0.08) == PACE * 0.08 / 2
    assert others.kept_bytes(100.0, 0.08) == 0


def beside_others() -> Competition:
    """Return one who knows that others fill the link, whose round trip was 20 ms without them and is 80 ms now."""
    others = Competition()
    others.advise(situation(80_000, 0.06))
    others.advise(situation(40_000, 0.06))
    assert others.competing
    return others


def told(others: Competition, window: int, rtt_s: float) -> float:
    """Tell of a round trip; return the window that is advised."""
    advice = others.advise(situation(window, rtt_s - 0.08, 1.0, 0.08))
    assert advice is not None
    return advice.window_bytes


def test_more_of_a_link_that_others_fill() -> None:
    """Beside others we send twice as much again and again, while that makes the queue no longer."""
    others = beside_others()
    assert told(others, 40_000, 0.08) == 80_000
    assert told(others, 80_000, 0.085) == 160_000
    assert others.competing


def test_others_have_left() -> None:
    """A queue that is longer with more of ours, and ever shorter with less, is ours: we yield to it again."""
    others = beside_others()
    told(others, 40_000, 0.08)
    for window, rtt_s, then in ((80_000, 0.16, 20_000), (20_000, 0.11, 10_000), (10_000, 0.08, 5_000)):
        assert told(others, window, rtt_s) == then
    advice = others.advise(situation(5_000, 0.0, 1.0, 0.08))
    assert advice is not None
    assert advice.base_s == 0.02
    assert not others.competing


def test_a_path_that_became_longer() -> None:
    """A round trip that is longer with more of ours, and then as long as before, is that of the path from now on."""
    others = beside_others()
    told(others, 40_000, 0.08)
    assert told(others, 80_000, 0.16) == 20_000
    assert told(others, 20_000, 0.08) == 10_000
    advice = others.advise(situation(10_000, 0.0, 1.0, 0.08))
    assert advice is not None
    assert advice.base_s == pytest.approx(0.08)
    assert not others.competing


def test_no_queue_beside_others() -> None:
    """Where the queue has gone, so have the others."""
    others = beside_others()
    assert others.advise(situation(40_000, 0.001)) is None
    assert not others.competing


def test_held_back_by_losses() -> None:
    """TCP is to forget its losses now and then while others fill the link; after one it waits, and we doubt that."""
    others = beside_others()
    assert others.held_back(situation(30_000, 0.0, 1.0, 0.08)) is None
    assert others.squeezed
    others.squeezed = False
    while not others.squeezed:
        assert others.held_back(situation(30_000, 0.0, 1.0, 0.08)) is None
    others.lost()
    for _ in range(20):
        advice = others.held_back(situation(30_000, 0.0, 1.0, 0.08))
        if advice is not None:
            break
        others.squeezed = False
    assert advice is not None
    assert advice.window_bytes == 15_000
    assert not others.squeezed


def test_the_least_window() -> None:
    """A long queue with the least window there is cannot be ours."""
    others = Competition()
    others.calm(PACE)
    advice = others.advise(situation(4096, 0.06))
    assert advice is not None
    assert advice.base_s is not None
    assert advice.window_bytes > 40_000


def ask(others: Competition, window: int, queue_s: float = 0.01) -> float:
    """See a queue that stays until more is sent; return how much."""
    for _ in range(100):
        advice = others.advise(situation(window, queue_s))
        if advice is not None:
            return advice.window_bytes
    raise AssertionError("nothing was tried")


def test_a_queue_that_stays() -> None:
    """Beside a queue that does not become longer as more is sent, ever more is sent; until it does, or is full."""
    others = Competition()
    window = ask(others, 20_000)
    assert 20_000 < window <= 40_000
    advice = others.advise(situation(int(window), 0.01))
    assert advice is not None
    assert advice.window_bytes > window
    assert advice.base_s == 0.03
    advice = others.advise(situation(int(advice.window_bytes), 0.03, base_s=0.03))
    assert advice is not None
    assert advice.window_bytes == int(window)
    window = ask(others, 20_000)
    others.lost()
    advice = others.advise(situation(int(window), 0.01))
    assert advice is not None
    assert advice.window_bytes == 20_000


@pytest.mark.parametrize("taken", [False, True])
def test_a_short_queue_next_to_us(taken: bool) -> None:
    """On a near link a short queue that stays is doubted only where others seem to have taken some of our pace."""
    others, advice = Competition(), []
    for i in range(200):
        pace = PACE / 2 if taken and i >= 50 else PACE
        advice.append(others.advise(situation(4096, 0.004, base_s=1e-4)._replace(bytes_per_s=pace, target_s=0.002)))
    assert any(a is not None for a in advice) is taken


@pytest.mark.parametrize(("precise", "noticed"), [(True, True), (False, False)])
def test_yielding_in_vain(precise: bool, noticed: bool) -> None:
    """A queue that is no shorter though less and less is sent is part of the path, where round trips are precise."""
    others, window = Competition(precise=precise), 40_000
    advice = others.advise(situation(window, 0.006))
    while advice is None and window > 30_000:
        window -= 1_000
        advice = others.advise(situation(window, 0.006))
    assert (advice is not None) is noticed
    if advice is not None:
        assert advice.base_s == pytest.approx(0.026)
        assert advice.window_bytes == pytest.approx(40_000)
        assert not others.competing
