"""Waiting for what has no signal of its own."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from typing import Final

from ropeway import aio

__all__ = ["PATIENCE_S", "until"]

PATIENCE_S: Final = 60.0 * float(os.environ.get("ROPEWAY_PATIENCE", "1"))
"""How long a test waits for what must happen: only a test that fails waits so long, however busy the machine is.
``ROPEWAY_PATIENCE`` multiplies it where the machine itself is slow, as an emulated one is.
"""


async def until(condition: Callable[[], object], timeout_s: float = PATIENCE_S) -> None:
    """Wait until ``condition()`` holds; what it looks up may not be there yet."""

    def holds() -> object:
        try:
            return condition()
        except LookupError:
            return False

    async with aio.timeout(timeout_s):
        while not holds():
            await asyncio.sleep(0.01)
