"""The known name that a misspelt one of a type may mean."""

from __future__ import annotations

import difflib
import time
from collections.abc import Callable, Iterable
from typing import Final

__all__ = ["Nearest"]

_CANDIDATES: Final = 200  # names that a misspelt one is compared with, each in about 10 us
_AT_ONCE: Final = 64  # misspelt names that are looked up at once, together in about 0.1 s
_PER_S: Final = 8.0  # and on average: whoever writes such names asks for no more, whoever floods gets no suggestion


class Nearest:
    """Finds names near others among ``names``, for as many as may be looked up; peers send as many as they like."""

    def __init__(self, names: Callable[[], Iterable[str]], *, clock: Callable[[], float] = time.monotonic) -> None:
        self._names, self._clock = names, clock
        self._by_part: dict[str, list[str]] | None = None  # by package, and by the last part in lower case
        self._left, self._at = float(_AT_ONCE), clock()

    def forget(self) -> None:
        """Ask for the names again: there are others now."""
        self._by_part = None

    def to(self, full: str) -> str:
        """Return the name that ``full`` may mean, ``""`` where none is near or too many were asked for."""
        now = self._clock()
        self._left, self._at = min(float(_AT_ONCE), self._left + (now - self._at) * _PER_S), now
        if self._left < 1.0:
            return ""
        self._left -= 1.0
        if self._by_part is None:
            self._by_part = self._sorted()
        package, _, base = full.split("/")
        candidates = [*self._by_part.get(package, ()), *self._by_part.get(base.lower(), ())]
        near = difflib.get_close_matches(full, candidates[:_CANDIDATES], 1, 0.75)
        return near[0] if near and near[0] != full else ""

    def _sorted(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for name in self._names():
            package, _, base = name.split("/")
            found.setdefault(package, []).append(name)
            found.setdefault(base.lower(), []).append(name)
        return found
