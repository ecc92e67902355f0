"""Turns for TLS handshakes: each takes memory before anybody is known, so only so many are under way at a time.

Whoever has begun one and does not end it keeps its turn as long as nobody else wants it, and a moment for sure.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

from ropeway.limits import HANDSHAKE_TURN_S, HANDSHAKES_AT_ONCE

__all__ = ["HandshakeTurns"]


class HandshakeTurns:
    """Gives turns in the order in which they are asked for."""

    def __init__(self, *, limit: int = HANDSHAKES_AT_ONCE, turn_s: float = HANDSHAKE_TURN_S) -> None:
        self.given_up = 0
        self._turn_s = turn_s
        self._free = asyncio.Semaphore(limit)
        self._under_way: dict[asyncio.Task[object], float] = {}  # since when, the oldest first
        self._waiting = 0
        self._timer: asyncio.TimerHandle | None = None

    @contextlib.asynccontextmanager
    async def turn(self) -> AsyncIterator[None]:
        """Wait for a turn, and have it; the task is cancelled if it takes long and others wait."""
        task = asyncio.current_task()
        assert task is not None
        self._waiting += 1
        try:
            if self._free.locked():
                self._watch()
            await self._free.acquire()
        finally:
            self._waiting -= 1
        self._under_way[task] = asyncio.get_running_loop().time()
        if self._waiting:
            self._watch()
        try:
            yield
        finally:
            self._under_way.pop(task, None)
            self._free.release()

    def _watch(self) -> None:
        if self._timer is None and self._under_way:
            oldest_s = next(iter(self._under_way.values()))
            self._timer = asyncio.get_running_loop().call_at(oldest_s + self._turn_s, self._due)

    def _due(self) -> None:
        self._timer = None
        if not self._waiting:
            return
        late_s = asyncio.get_running_loop().time() - self._turn_s
        for task in [task for task, since_s in self._under_way.items() if since_s <= late_s][: self._waiting]:
            del self._under_way[task]
            self.given_up += 1
            task.cancel("its TLS handshake takes long, and others wait")
        self._watch()
