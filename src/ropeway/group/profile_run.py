"""Asks each member for a moment, in turns, so that all see the same weather. Sans-I/O.

Latencies of compressed video rise and fall on all machines together: who is asked for a tenth of a second, and then
another for the next tenth, is compared with another time. In turns, neighbours are a frame apart.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from ropeway.group.options import Options

__all__ = ["ProfileRun"]

_LEAST_PATIENCE_S: Final = 0.5  # for answers to what was asked in the profile
_LONGER: Final = 8  # times what each has in a profile, for all of them together
_PATIENCE_LIMITS: Final = 2  # as many times the limit, at most, if that is longer


class ProfileRun:
    """The profile of members, from ``now_s`` on."""

    def __init__(self, names: Iterable[str], now_s: float, options: Options, limit_s: float | None) -> None:
        self._options = options
        self._asked = dict.fromkeys(names, 0)
        self._open: dict[str, int] = dict(self._asked)
        self._asks_until_s = now_s + options.profile_s * len(self._asked)
        self._patience_s = max(_LEAST_PATIENCE_S, _PATIENCE_LIMITS * (limit_s or 0.0))
        self._asked_last_s = now_s
        self.longer = False

    def go_on(self, now_s: float) -> None:
        """Ask all for some time more: what was learnt tells too little."""
        self.longer = True
        self._asks_until_s = now_s + _LONGER * self._options.profile_s

    @property
    def names(self) -> tuple[str, ...]:
        """Return who is asked."""
        return tuple(self._asked)

    def next(self, now_s: float) -> str:
        """Return who gets the next request: whoever had the fewest; ``""`` once all have had theirs."""
        name = min(self._asked, key=self._asked.__getitem__, default="")
        return name if name and (now_s < self._asks_until_s or not self._asked[name]) else ""

    def joined(self, name: str) -> None:
        """Ask a member that has come, too."""
        if name not in self._asked:
            self._asked[name] = self._open[name] = 0
            self._asks_until_s += self._options.profile_s

    def left(self, name: str) -> None:
        """Ask a member that is gone no longer."""
        self._asked.pop(name, None)
        self._open.pop(name, None)

    def asked(self, name: str, now_s: float) -> None:
        """Note a request."""
        if name in self._asked:
            self._asked[name] += 1
            self._open[name] += 1
            self._asked_last_s = now_s

    def answered(self, name: str) -> None:
        """Note an answer, or that none will come."""
        if self._open.get(name):
            self._open[name] -= 1

    def over(self, now_s: float) -> bool:
        """Return whether all were asked, and answered half of it, or have had time to."""
        if self.next(now_s):
            return False
        waited_s = now_s - max(self._asks_until_s, self._asked_last_s)
        heard = all(2 * self._open[name] <= asked for name, asked in self._asked.items())
        return heard or waited_s >= self._patience_s
