"""Waiting for what has no signal of its own."""

from __future__ import annotations

import asyncio
from collections.abc import Callable


async def until(condition: Callable[[], object], timeout_s: float = 10.0) -> None:
    """Wait until ``condition()`` holds; what it looks up may not be there yet."""

    def holds() -> object:
        try:
            return condition()
        except LookupError:
            return False

    async with asyncio.timeout(timeout_s):
        while not holds():
            await asyncio.sleep(0.01)
