"""Tells copies from replays: what is sent by several ways comes several times, and each time by another way.

A copy is what was received before by another way, and not yet by this one. What comes twice by the same way is a
replay. Neither is ever delivered: the difference is how it is counted.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Final

from ropeway.networks.overlay.crypto.replay_window import ReplayWindow

__all__ = ["BYPASS", "Arrivals", "NoteCopies", "Way"]

Way = tuple[int, int]
"""The number of the session by which something came here, and of that by which it was sent there."""

BYPASS: Final[Way] = (-1, -1)
"""The way of copies of small messages."""

_REMEMBERED: Final = 1024  # notes: a few seconds of all that a fleet of hundreds tells


class Arrivals:
    """Remembers by which ways the packets of one publisher came; numbers below ``floor`` are too old."""

    def __init__(self, floor: int) -> None:
        self._floor = floor
        self._windows: dict[Way, ReplayWindow] = {}

    def came(self, way: Way, first: int, count: int) -> None:
        """Note that a packet with ``count`` numbers from ``first`` on was opened."""
        self._window(way).take(first, count)

    def is_copy(self, way: Way, first: int, count: int) -> bool:
        """Return whether a packet that came before by another way comes by this way for the first time; note it."""
        window = self._window(way)
        if window.judge(first, count) is not None:
            return False
        window.take(first, count)
        return True

    def _window(self, way: Way) -> ReplayWindow:
        window = self._windows.get(way)
        if window is None:
            window = self._windows[way] = ReplayWindow(self._floor)
        return window


class NoteCopies:
    """Remembers the notes that came lately, and by which of our sessions; ``count`` is that of copies."""

    def __init__(self) -> None:
        self.count = 0
        self._came: OrderedDict[int, int] = OrderedDict()  # by hash: a bit for each session

    def is_copy(self, session: int, key: str, payload: bytes) -> bool:
        """Return whether the same came by another session, and not by this one; note it."""
        note, bit = hash((key, payload)), 1 << session
        before = self._came.get(note, 0)
        self._came[note] = before | bit
        self._came.move_to_end(note)
        if len(self._came) > _REMEMBERED:
            self._came.popitem(last=False)
        copy = before != 0 and not before & bit
        self.count += copy
        return copy
