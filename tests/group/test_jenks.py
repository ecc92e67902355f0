"""ropeway.group.jenks: natural breaks, against all there are."""

from __future__ import annotations

import itertools
import random

import pytest

from ropeway.group.jenks import goodness_of_fit, latency_classes, natural_breaks


def spread(groups: list[list[float]]) -> float:
    """Return the sum of squares within the groups."""
    return sum(sum((v - sum(g) / len(g)) ** 2 for v in g) for g in groups)


@pytest.mark.parametrize("seed", range(12))
def test_least_spread(seed: int) -> None:
    """No other cut of the values into as many classes has less spread in them."""
    rng = random.Random(seed)
    values = sorted(rng.choice([0.01, 0.05, 0.2]) * rng.uniform(0.8, 1.2) for _ in range(rng.randint(4, 11)))
    for classes in (2, 3, 4):
        found = natural_breaks(values, classes)
        assert [v for group in found for v in group] == values and len(found) == classes
        every = (
            [values[a:b] for a, b in itertools.pairwise((0, *cuts, len(values)))]
            for cuts in itertools.combinations(range(1, len(values)), classes - 1)
        )
        assert spread(found) == pytest.approx(min(map(spread, every)), abs=1e-12)


def test_fewer_values_than_classes() -> None:
    """Of fewer values than classes each is a class, and of none there is no class."""
    assert natural_breaks([0.2, 0.1], 4) == [[0.1], [0.2]]
    assert natural_breaks([], 3) == []
    assert latency_classes([]) == ((), 1.0)


def test_two_kinds_of_latency() -> None:
    """A machine that is slow every second time has two classes, which explain nearly all."""
    rng = random.Random(1)
    values = [base + rng.uniform(0, 0.002) for base in (0.01, 0.05) for _ in range(300)]
    classes, fit = latency_classes(values)
    assert [round(c.mean_s, 3) for c in classes] == [0.011, 0.051]
    assert [round(c.share, 1) for c in classes] == [0.5, 0.5]
    assert fit > 0.99
    assert classes[0].as_json()["share"] == pytest.approx(0.5, abs=0.01)


def test_all_alike() -> None:
    """Latencies that are all the same are one class."""
    classes, fit = latency_classes([0.01] * 20)
    assert len(classes) == 1 and fit == 1.0


def test_nothing_explained() -> None:
    """One class of unlike values explains none of their spread."""
    assert goodness_of_fit([[0.1, 0.2, 0.3]]) == pytest.approx(0.0)
    assert goodness_of_fit([]) == 1.0
