"""The shortest of the last few round trips of a path on which one lost packet delays all that were sent after it."""

from __future__ import annotations

from collections import deque
from typing import Final

__all__ = ["ShortestRoundTrip"]

_LEAST: Final = 8  # so many count, whatever their age
_HELD_UP: Final = 1 / 16  # of a pause counts as time: what comes after it waited as long, all of it


class ShortestRoundTrip:
    """The shortest of the round trips within a time, ``rtt_s``; zero while there is none."""

    def __init__(self) -> None:
        self.rtt_s = 0.0
        self._clock_s = 0.0
        self._count = 0
        self._least: deque[tuple[int, float, float]] = deque()  # each longer than the one before: number, when, length

    def __bool__(self) -> bool:
        """Return whether there is one."""
        return bool(self._least)

    def passed(self, seconds: float, *, pause: bool) -> None:
        """Let time pass; with ``pause``, packets were held up in it."""
        self._clock_s += _HELD_UP * seconds if pause else seconds

    def add(self, rtt_s: float, memory_s: float) -> None:
        """Add a round trip; forget those that are older than ``memory_s``."""
        least = self._least
        self._count += 1
        while least and least[-1][2] >= rtt_s:
            least.pop()
        least.append((self._count, self._clock_s, rtt_s))
        while least[0][0] <= self._count - _LEAST and least[0][1] < self._clock_s - memory_s:
            least.popleft()
        self.rtt_s = least[0][2]
