"""What a hostile member sends, and what it costs to read it."""

from __future__ import annotations

import contextlib
import tracemalloc
from collections.abc import Callable
from functools import cache

import zstandard

from ropeway.errors import SealError

__all__ = ["bomb", "peak_bytes"]


@cache
def bomb(size: int) -> bytes:
    """Return the ``zstd`` body of so many zeros."""
    compressor = zstandard.ZstdCompressor(level=19).compressobj(size=size)
    block = bytes(1 << 20)
    parts = [compressor.compress(block[: min(size - at, len(block))]) for at in range(0, size, len(block))]
    return b"\1" + b"".join(parts) + compressor.flush()


def peak_bytes(work: Callable[[], object]) -> int:
    """Return how much memory ``work`` took at most, whether it was refused or not."""
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        with contextlib.suppress(SealError):
            work()
        return tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
