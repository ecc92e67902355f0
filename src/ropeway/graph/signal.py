"""A change that any number of tasks wait for."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from ropeway import aio

__all__ = ["Signal"]


class Signal:
    """Wakes everybody who waits when ``notify`` is called; who waits later, waits for the next call."""

    def __init__(self) -> None:
        self._event = asyncio.Event()

    def notify(self) -> None:
        """Wake everybody who waits now."""
        self._event.set()
        self._event = asyncio.Event()

    async def wait(self) -> None:
        """Wait for the next ``notify``."""
        await self._event.wait()

    async def wait_for(self, condition: Callable[[], object], timeout_s: float) -> bool:
        """Wait until ``condition`` holds, which is looked at after each ``notify``; return false when time is over."""
        try:
            async with aio.timeout(timeout_s):
                while not condition():
                    await self.wait()
        except TimeoutError:
            return False
        return True
