"""Reads memory of this process that may not be there, so that a wrong guess about it is no crash."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator

__all__ = ["read", "words"]

_memory = -1  # the file of this process's memory, once it is open


def read(address: int, size: int) -> bytes:
    """Return memory of this process: less or none where there is not so much. Raises ``OSError`` without ``/proc``."""
    global _memory
    if _memory < 0:
        _memory = os.open("/proc/self/mem", os.O_RDONLY | os.O_CLOEXEC)
    try:
        return os.pread(_memory, size, address)
    except (OSError, OverflowError):
        return b""


def words(address: int, size: int) -> Iterator[int]:
    """Yield the words of 8 bytes that lie there, as far as there is memory."""
    data = read(address, size)
    return (word for (word,) in struct.iter_unpack("=Q", data[: len(data) & -8]))
