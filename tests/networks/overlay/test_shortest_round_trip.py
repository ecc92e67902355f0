"""The shortest of the last round trips."""

from __future__ import annotations

import random

from ropeway.networks.overlay.shortest_round_trip import ShortestRoundTrip


def test_the_shortest_within_the_memory() -> None:
    """The shortest of those within the memory counts, as if all were looked at."""
    chance = random.Random(1)
    shortest, all_s, now_s = ShortestRoundTrip(), [], 0.0
    assert not shortest
    for _ in range(2000):
        gap_s, rtt_s = chance.uniform(0.0, 0.01), chance.uniform(0.02, 0.05)
        now_s += gap_s
        shortest.passed(gap_s, pause=False)
        shortest.add(rtt_s, 0.1)
        all_s.append((now_s, rtt_s))
        within = [rtt_s for at_s, rtt_s in all_s[:-8] if at_s >= now_s - 0.1 - 1e-9] + [r for _, r in all_s[-8:]]
        assert shortest.rtt_s == min(within)
    assert shortest


def test_the_last_few_count_at_any_age() -> None:
    """The last eight count, however old they are."""
    shortest = ShortestRoundTrip()
    shortest.add(0.01, 0.0)
    for number in range(1, 9):
        shortest.passed(100.0, pause=False)
        shortest.add(0.05, 0.0)
        assert shortest.rtt_s == (0.01 if number < 8 else 0.05)


def test_a_pause_hardly_counts() -> None:
    """What waited all at once after a pause does not displace what came before it."""
    shortest = ShortestRoundTrip()
    shortest.add(0.02, 0.06)
    shortest.passed(0.1, pause=True)
    for _ in range(20):
        shortest.add(0.1, 0.06)
    assert shortest.rtt_s == 0.02
    shortest.passed(0.1, pause=False)
    shortest.add(0.1, 0.06)
    assert shortest.rtt_s == 0.1
