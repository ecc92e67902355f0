"""Finds the clock that latencies are measured with."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Final

__all__ = ["steady_clock"]

_SAME_S: Final = 1.0
"""A loop whose time differs by more from the clock of the system has one of its own."""


def steady_clock(loop: asyncio.AbstractEventLoop) -> Callable[[], float]:
    """Return the clock of the system where the loop goes by it, else that of the loop.

    The time of uvloop counts whole milliseconds and stands still within a turn, which is too coarse for latencies.
    """
    return time.monotonic if abs(loop.time() - time.monotonic()) < _SAME_S else loop.time
