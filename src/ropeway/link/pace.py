"""How fast a link carries bytes away, measured while it is busy.

Only a link that holds bytes back shows its pace: what it carried between the moment at which it took no more and the
moment at which it did again. A link that never holds anything back is faster than what is asked of it, and its pace
is unknown (``None``).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

__all__ = ["Pace"]

_MEMORY_S: Final = 0.1  # of busy time: recent traffic counts, but one odd moment does not
_LEAST_BYTES: Final = 2048


class Pace:
    """The pace of one connection. ``bytes_per_s`` is ``None`` until the link has been busy."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.bytes_per_s: float | None = None
        self.last = float("-inf")
        self.samples = 0
        self._bytes = 0.0
        self._seconds = 0.0

    def carried(self, size_bytes: int, seconds: float) -> None:
        """The busy link has carried so many bytes in so many seconds."""
        self.last = self._clock()
        if size_bytes < _LEAST_BYTES:
            return
        self.samples += 1
        seconds = max(seconds, 1e-5)
        keep = 0.5 ** (seconds / _MEMORY_S)
        if keep < 1 and self._seconds > _MEMORY_S:
            keep = min(keep, _MEMORY_S / self._seconds)
        self._bytes = self._bytes * keep + size_bytes
        self._seconds = self._seconds * keep + seconds
        self.bytes_per_s = self._bytes / self._seconds

    def idle_s(self) -> float:
        """Seconds since the link last held anything back."""
        return self._clock() - self.last

    def forget(self) -> None:
        """Call the pace unknown again."""
        self.bytes_per_s = None
        self._bytes = self._seconds = 0.0
