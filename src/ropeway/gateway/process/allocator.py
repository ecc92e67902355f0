"""Tunes the allocator for messages of hundreds of kilobytes, thirty times a second."""

from __future__ import annotations

import asyncio
import ctypes
import logging
from typing import Final

__all__ = ["FreedMemory", "keep_freed_memory"]

log = logging.getLogger("ropeway.gateway")

_M_TRIM_THRESHOLD: Final = -1
_M_MMAP_THRESHOLD: Final = -3
_M_ARENA_MAX: Final = -8
_TRIM_BYTES: Final = 16 << 20
_MMAP_BYTES: Final = 4 << 20
_PAUSE_S: Final = 2.0  # until all that a connection held is free, and others that end with it have ended


def keep_freed_memory() -> None:
    """Make the C library keep up to 16 MB of freed memory instead of returning that of every image to the kernel.

    By default an image is mapped, faulted in page by page and unmapped again at every hop, which costs ten times
    what copying it does. Without effect where the C library is not glibc.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return
    for option, value in ((_M_TRIM_THRESHOLD, _TRIM_BYTES), (_M_MMAP_THRESHOLD, _MMAP_BYTES), (_M_ARENA_MAX, 2)):
        if not mallopt(option, value):
            log.debug("mallopt(%d, %d) was refused", option, value)


class FreedMemory:
    """Gives memory that is free back to the system, a moment after it was ``due``: pieces between others stay else."""

    def __init__(self, *, pause_s: float = _PAUSE_S) -> None:
        self.given_back = 0  # times
        self._pause_s = pause_s
        self._timer: asyncio.TimerHandle | None = None

    def due(self) -> None:
        """Have it given back soon, once however often this is called until then."""
        if self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(self._pause_s, self._give_back)

    def close(self) -> None:
        """Leave it as it is."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _give_back(self) -> None:
        self._timer = None
        try:
            ctypes.CDLL(None).malloc_trim(0)  # a millisecond for a hundred megabytes
        except (OSError, AttributeError):
            return
        self.given_back += 1
