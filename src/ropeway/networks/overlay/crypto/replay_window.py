"""Remembers which numbers of a counter were received, within a window, and tells replays from numbers that
are too old.
"""

from __future__ import annotations

from typing import Final

from ropeway.networks.overlay.refusal import Refusal

__all__ = ["WINDOW", "ReplayWindow"]

WINDOW: Final = 4096


class ReplayWindow:
    """The numbers that came, from ``floor`` on; smaller ones are too old."""

    __slots__ = ("_seen", "_top", "floor")

    def __init__(self, floor: int = 1) -> None:
        self.floor = floor
        self._top = floor - 1  # the highest that came
        self._seen = 0  # bit i: the number _top - i came

    def judge(self, first: int, count: int = 1) -> Refusal | None:
        """Return why ``count`` numbers from ``first`` on are refused, ``None`` if they are not."""
        if first < self.floor or first + count <= self._top + 1 - WINDOW:
            return Refusal.TOO_OLD
        last = first + count - 1
        if first > self._top:
            return None
        shift = max(self._top - last, 0)
        width = min(self._top, last) - first + 1
        return Refusal.REPLAYED if self._seen >> shift & ((1 << width) - 1) else None

    def take(self, first: int, count: int = 1) -> None:
        """Mark these sequence numbers as received."""
        last = first + count - 1
        if last > self._top:
            moved = last - self._top
            self._seen = self._seen << moved & ((1 << WINDOW) - 1) if moved < WINDOW else 0
            self._top = last
        mask = ((1 << count) - 1) << (self._top - last)
        self._seen = (self._seen | mask) & ((1 << WINDOW) - 1)
