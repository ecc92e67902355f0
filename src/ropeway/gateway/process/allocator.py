"""Tunes the allocator for messages of hundreds of kilobytes, thirty times a second."""

from __future__ import annotations

import ctypes
import logging
from typing import Final

__all__ = ["keep_freed_memory"]

log = logging.getLogger("ropeway.gateway")

_M_TRIM_THRESHOLD: Final = -1
_M_MMAP_THRESHOLD: Final = -3
_M_ARENA_MAX: Final = -8
_TRIM_BYTES: Final = 16 << 20
_MMAP_BYTES: Final = 4 << 20


def keep_freed_memory() -> None:
    """Have the C library keep up to 16 MB of freed memory instead of giving every image back to the kernel.

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
