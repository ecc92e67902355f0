"""How fast a link carries bytes away, measured while it is busy.

Only a link that holds bytes back shows its pace: what the transport could not hand to the operating system at
``paused`` has gone by ``resumed``, and the time between is the link's. A link that never pauses is faster than
what is asked of it, and its pace is unknown (``None``).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

__all__ = ["Pace"]

_HALF_LIFE_BYTES: Final = 512 * 1024  # recent traffic counts, but one odd pause does not
_MIN_SAMPLE_S: Final = 0.0005


class Pace:
    """The pace of one connection. ``bytes_per_s`` is ``None`` until the link has been busy."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.bytes_per_s: float | None = None
        self.paused_at: float | None = None
        self.last_pause = float("-inf")
        self._left = 0
        self._sent_while_paused = 0
        self._bytes = 0.0
        self._seconds = 0.0
        self.pauses = 0

    def sent(self, size_bytes: int) -> None:
        """Bytes were handed to the transport."""
        if self.paused_at is not None:
            self._sent_while_paused += size_bytes

    def paused(self, left_bytes: int) -> None:
        """The transport began to hold ``left_bytes`` back."""
        self.paused_at = self.last_pause = self._clock()
        self._left = left_bytes
        self._sent_while_paused = 0
        self.pauses += 1

    def resumed(self) -> None:
        """The transport has handed over everything."""
        if self.paused_at is None:
            return
        now = self._clock()
        seconds = now - self.paused_at
        carried = self._left + self._sent_while_paused
        self.paused_at = None
        self.last_pause = now
        if seconds < _MIN_SAMPLE_S and carried < 65536:
            return
        keep = 0.5 ** (carried / _HALF_LIFE_BYTES)
        self._bytes = self._bytes * keep + carried
        self._seconds = self._seconds * keep + max(seconds, 1e-6)
        self.bytes_per_s = self._bytes / self._seconds

    def idle_s(self) -> float:
        """Seconds since the link last held anything back; 0 while it does."""
        return 0.0 if self.paused_at is not None else self._clock() - self.last_pause

    def forget(self) -> None:
        """Call the pace unknown again."""
        self.bytes_per_s = None
        self._bytes = self._seconds = 0.0
