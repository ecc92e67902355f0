"""Keeps the last values of figures, for sparklines and plots."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Final

__all__ = ["KEPT_VALUES", "Histories"]

KEPT_VALUES: Final = 120
"""Two minutes at a look per second."""


class Histories:
    """The last values of many figures; those that are no longer told are forgotten."""

    def __init__(self, kept: int = KEPT_VALUES) -> None:
        self._kept = kept
        self._values: dict[str, deque[float]] = {}

    def add(self, values: Mapping[str, float]) -> None:
        """Add a value to each figure."""
        self._values = {key: self._values.get(key) or deque(maxlen=self._kept) for key in values}
        for key, value in values.items():
            self._values[key].append(value)

    def of(self, key: str) -> Iterable[float]:
        """Return the values of a figure, the oldest first."""
        return tuple(self._values.get(key, ()))
