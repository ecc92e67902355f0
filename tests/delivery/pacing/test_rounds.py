"""Round trips: what bounds them, and what one that is over tells."""

from __future__ import annotations

import pytest

from ropeway.delivery.pacing.rounds import LinkReading, Round, RoundTripBounds

SEGMENT = 1448


def reading(now: float, delivered: int, in_flight: int, *, rtt: float = 0.03, lost: int = 0) -> LinkReading:
    """A reading of segments; the smoothed round trip is behind."""
    return LinkReading(now, delivered * SEGMENT, in_flight * SEGMENT, 0, rtt, 0.0, lost, SEGMENT)


def test_at_least() -> None:
    """What is still in flight takes at least the time since it was, but for segments that are acknowledged late."""
    bounds = RoundTripBounds()
    shown = []
    for now, delivered, in_flight in ((0.0, 0, 10), (0.01, 4, 10), (0.02, 7, 10), (0.03, 9, 10), (0.035, 10, 10)):
        bounds.observe(reading(now, delivered, in_flight))
        shown.append(bounds.at_least_s)
    assert shown == [0.0, 0.01, 0.02, 0.0, 0.035 - 0.03]


def test_at_most() -> None:
    """What was not sent yet at one reading and has arrived at another took no longer than the time between them."""
    bounds = RoundTripBounds()
    shown = []
    for now, delivered, in_flight in ((0.0, 0, 2), (0.01, 2, 2), (0.015, 3, 2), (0.02, 5, 0), (9.0, 5, 0), (9.1, 6, 1)):
        bounds.observe(reading(now, delivered, in_flight))
        shown.append(bounds.at_most_s)
    none = float("inf")
    assert shown == [none, none, 0.015, none, none, 9.1 - 9.0]


def test_nothing_of_what_is_lost() -> None:
    """Where packets are sent again nobody knows which arrived: there are no bounds, until others were sent."""
    bounds = RoundTripBounds()
    bounds.observe(reading(0.0, 0, 10))
    bounds.observe(reading(0.02, 5, 10, lost=1))
    assert (bounds.at_least_s, bounds.at_most_s) == (0.0, float("inf"))
    bounds.observe(reading(0.03, 6, 10, lost=1))
    assert bounds.at_least_s == 0.03 - 0.02


def test_a_round_of_few() -> None:
    """The smoothed round trip counts where enough has arrived to smooth; with less, what bounds it does as well."""
    for segments, shortest in ((40, 0.03), (4, 0.005)):
        begin = reading(0.0, 0, 2)
        current, bounds = Round(begin, begin.in_flight_bytes), RoundTripBounds()
        bounds.observe(begin)
        for i in range(1, 5):
            now = reading(0.005 * i, segments // 4 * i, 0)
            bounds.observe(now)
            current.note(now, bounds, held=True, kernel_holds=False)
        assert current.is_over(now)
        assert current.shortest_s(now) == pytest.approx(shortest)
