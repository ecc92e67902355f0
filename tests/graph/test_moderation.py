"""When a thread rests between messages."""

from __future__ import annotations

import pytest

from ropeway.graph.moderation import REST_S, Moderation


class _Clock:
    """Counts nanoseconds, and goes on when it is told to."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000

    def __call__(self) -> int:
        return self.now_ns


def _after(rates_hz: list[int], *, before: int = 0) -> Moderation:
    """Return what is decided after as many messages as are looked at, at each rate in turn."""
    clock = _Clock()
    moderation = Moderation(before, clock=clock)
    samples = before
    for rate_hz in rates_hz:
        wanted = moderation.next_look
        while samples < wanted:
            samples += 1
            clock.now_ns += 1_000_000_000 // rate_hz
        moderation.look(samples)
    return moderation


@pytest.mark.parametrize(
    ("rates_hz", "rests"),
    [([60], False), ([2000], False), ([10_000], True), ([60_000], True), ([10_000, 100], False), ([100, 30_000], True)],
)
def test_rests_while_many_come(rates_hz: list[int], *, rests: bool) -> None:
    """The thread rests where the next messages come within moments, and wakes at once again when they do no more."""
    assert _after(rates_hz).rests is rests


def test_a_burst_now_and_then_is_not_many() -> None:
    """A burst after a pause counts with the pause."""
    clock = _Clock()
    moderation = Moderation(clock=clock)
    for burst in range(1, 4):
        clock.now_ns += 100_000_000
        moderation.look(50 * burst)
        assert not moderation.rests


def test_what_came_before_does_not_count() -> None:
    """Messages of an earlier run of the thread are no sign of many."""
    assert not _after([100], before=1_000_000).rests


def test_a_rest_is_short() -> None:
    """A rest holds nobody up for more than a quarter of a millisecond, with the slack of the system's timers."""
    assert REST_S + 50e-6 <= 250e-6
