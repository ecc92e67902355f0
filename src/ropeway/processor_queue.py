"""Leaves out of account the time in which another process waited for a processor: a busy machine is no fault of it.

A process of ours that has to do something within some seconds is ended where it does not, as one that hangs. One that
the machine does not let run only needs longer, and to start another instead would make it worse.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

from ropeway import aio

__all__ = ["ProcessorQueue", "patience", "queued_s"]


def queued_s(pid: int | None) -> float:
    """Return how long the first thread of a process has waited for a processor in all; 0 where nothing counts that."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text("ascii").split()[1]) / 1e9
    except (OSError, IndexError, ValueError):  # no such process, or no Linux that counts it
        return 0.0


class ProcessorQueue:
    """Reads how long a process waited for a processor. ``pid`` tells which one it is, as another may take its place."""

    def __init__(self, pid: Callable[[], int | None]) -> None:
        self._pid = pid
        self._of, self._before_s = pid(), queued_s(pid())

    def lap(self) -> float:
        """Return how many seconds it has waited since this was asked last, or since this was made."""
        pid = self._pid()
        now_s = queued_s(pid)
        since_s = self._before_s if pid == self._of else 0.0
        self._of, self._before_s = pid, now_s
        return max(now_s - since_s, 0.0)


@asynccontextmanager
async def patience(seconds: float, pid: Callable[[], int | None]) -> AsyncIterator[None]:
    """Bound a block that waits for a process, by seconds in which that did not wait for a processor.

    Raises ``TimeoutError``.
    """
    loop = asyncio.get_running_loop()
    queue = ProcessorQueue(pid)
    until_s = loop.time() + seconds
    handle: asyncio.TimerHandle
    async with aio.timeout(None) as bound:

        def look() -> None:
            nonlocal until_s, handle
            until_s += queue.lap()
            if until_s > loop.time():
                handle = loop.call_at(until_s, look)
            else:
                bound.reschedule(until_s)

        handle = loop.call_at(until_s, look)
        try:
            yield
        finally:
            handle.cancel()
