"""Natural breaks of latencies: classes with as little spread in each as can be (Fisher and Jenks). Sans-I/O.

FogROS2-LS sorts latencies into 2 to 4 classes and takes the first number whose goodness of variance fit is above 0.9;
classes of less than 5 % are chance. Written with numpy here, which is there anyway: the package that the thesis uses
has no wheels for some of the Pythons that Ropeway runs on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

__all__ = ["LatencyClass", "goodness_of_fit", "latency_classes", "natural_breaks"]

_MOST_CLASSES: Final = 4
_GOOD_FIT: Final = 0.9
_LEAST_SHARE: Final = 0.05
_MOST_VALUES: Final = 256  # of more, as many quantiles: the work grows with the square
_NO_SPREAD_S: Final = 1e-9  # a billionth of a second is the error of adding, and no difference


@dataclass(frozen=True, slots=True)
class LatencyClass:
    """Latencies that belong together: from, to, mean in seconds, and their share of all."""

    least_s: float
    most_s: float
    mean_s: float
    share: float

    def as_json(self) -> dict[str, float]:
        """Return the numbers, in seconds."""
        return {
            "from": round(self.least_s, 6),
            "to": round(self.most_s, 6),
            "mean": round(self.mean_s, 6),
            "share": round(self.share, 3),
        }


def natural_breaks(values: Sequence[float], classes: int) -> list[list[float]]:
    """Return the values in ``classes`` groups, in order of size, with the least sum of squares in them.

    There are fewer where there are fewer values.
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    n = len(ordered)
    classes = max(1, min(classes, n))
    if not n:
        return []
    sums = np.concatenate([[0.0], np.cumsum(ordered)])
    squares = np.concatenate([[0.0], np.cumsum(ordered**2)])
    ends = np.arange(n + 1)
    many = ends[None, :] - ends[:, None]
    within = squares[None, :] - squares[:, None] - (sums[None, :] - sums[:, None]) ** 2 / np.maximum(many, 1)
    within[many <= 0] = np.inf  # [start, end]: the sum of squares of one class
    cuts = np.zeros((classes, n + 1), dtype=int)
    cost = within[0]
    for number in range(1, classes):
        total = cost[:, None] + within
        cuts[number] = np.argmin(total, axis=0)
        cost = np.min(total, axis=0)
    found, end = [], n
    for number in range(classes - 1, -1, -1):
        start = int(cuts[number, end])
        found.append(ordered[start:end].tolist())
        end = start
    return found[::-1]


def goodness_of_fit(groups: Sequence[Sequence[float]]) -> float:
    """Return the goodness of variance fit: 1 where every class is one value, 0 where classes explain nothing."""
    every = np.concatenate([np.asarray(group, dtype=float) for group in groups]) if groups else np.zeros(0)
    if not every.size:
        return 1.0
    total = float(((every - every.mean()) ** 2).sum())
    within = sum(float(((np.asarray(g) - np.mean(g)) ** 2).sum()) for g in groups if len(g))
    return 1.0 if total <= every.size * _NO_SPREAD_S**2 else max(0.0, 1 - within / total)


def latency_classes(values: Sequence[float]) -> tuple[tuple[LatencyClass, ...], float]:
    """Return the classes of latencies, and how well they fit.

    One class where all are alike; else the fewest of up to 4 that fit well, or 4. Classes of next to nothing are left
    out.
    """
    if not len(values):
        return (), 1.0
    if len(values) > _MOST_VALUES:
        values = np.quantile(np.asarray(values, dtype=float), np.linspace(0, 1, _MOST_VALUES)).tolist()
    groups, fit = [list(values)], goodness_of_fit([values])
    for count in range(2, _MOST_CLASSES + 1):
        if fit > _GOOD_FIT:
            break
        groups = natural_breaks(values, count)
        fit = goodness_of_fit(groups)
    many = len(values)
    classes = (LatencyClass(min(g), max(g), sum(g) / len(g), len(g) / many) for g in groups)
    return tuple(found for found in classes if found.share > _LEAST_SHARE), fit
