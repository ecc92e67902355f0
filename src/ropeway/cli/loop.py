"""Runs a verb's coroutine on the fastest event loop there is."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

from ropeway import aio

__all__ = ["run"]

T = TypeVar("T")


def run(coroutine: Coroutine[Any, Any, T]) -> T:
    """Run ``coroutine`` and return its result. Ctrl-C cancels it, lets it clean up and raises ``KeyboardInterrupt``."""
    try:
        import uvloop
    except ImportError:  # not on every platform
        return asyncio.run(coroutine)
    with aio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        return runner.run(coroutine)
