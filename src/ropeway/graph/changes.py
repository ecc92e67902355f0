"""The events of discovery, for any number of listeners."""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import dataclass, field

from ropeway.graph.base import GraphEvent

__all__ = ["Changes"]


@dataclass
class Changes:
    """Fans discovery events out to every ``changes()`` iterator; each has a bounded queue that keeps the newest.

    ``emitted`` counts the events, so that what was made of an earlier state is known to be old.
    """

    limit: int = 4096
    emitted: int = 0
    _queues: list[tuple[deque[GraphEvent], asyncio.Event]] = field(default_factory=list)
    closed: bool = False

    def emit(self, event: GraphEvent) -> None:
        """Give the event to all who listen."""
        self.emitted += 1
        for queue, wake in self._queues:
            queue.append(event)
            wake.set()

    def close(self) -> None:
        """End every iterator once it has given what it has."""
        self.closed = True
        for _, wake in self._queues:
            wake.set()

    def listen(self) -> AsyncIterator[GraphEvent]:
        """Iterate over every event from this call on."""
        entry = (deque[GraphEvent](maxlen=self.limit), asyncio.Event())
        self._queues.append(entry)
        return self._drain(entry)

    async def _drain(self, entry: tuple[deque[GraphEvent], asyncio.Event]) -> AsyncIterator[GraphEvent]:
        queue, wake = entry
        try:
            while True:
                while queue:
                    yield queue.popleft()
                if self.closed:
                    return
                await wake.wait()
                wake.clear()
        finally:
            with contextlib.suppress(ValueError):
                self._queues.remove(entry)
