"""A queue that lets one message go in every period: what rosbridge makes of ``throttle_rate`` with ``queue_length``."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from ropeway.graph.base import Sample

__all__ = ["Throttle"]


class Throttle:
    """The first message goes at once; of what comes within ``period_s`` after the last, the newest ``length`` wait.

    ``dropped`` is called for each message that a newer one displaces.
    """

    def __init__(
        self, period_s: float, length: int, send: Callable[[Sample], None], dropped: Callable[[], None]
    ) -> None:
        self._period_s, self._length = period_s, max(length, 1)
        self._send, self._dropped = send, dropped
        self._waiting: deque[Sample] = deque()
        self._timer: asyncio.TimerHandle | None = None

    def put(self, sample: Sample) -> None:
        """Send a message, or let it wait for its time."""
        if self._timer is None:
            self._go(sample)
            return
        if len(self._waiting) >= self._length:
            self._waiting.popleft()
            self._dropped()
        self._waiting.append(sample)

    def _go(self, sample: Sample) -> None:
        self._timer = asyncio.get_running_loop().call_later(self._period_s, self._next)
        self._send(sample)

    def _next(self) -> None:
        self._timer = None
        if self._waiting:
            self._go(self._waiting.popleft())

    def close(self) -> list[Sample]:
        """Send no more; gives what still waits."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        waiting = list(self._waiting)
        self._waiting.clear()
        return waiting
