"""A queue that lets one message go in every period: what rosbridge makes of ``throttle_rate`` with ``queue_length``."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from ropeway.graph.base import Sample
from ropeway.limits import THROTTLED_BYTES, THROTTLED_MESSAGES

__all__ = ["Throttle"]


class Throttle:
    """The first message goes at once; of what comes within ``period_s`` after the last, the newest ``length`` wait.

    No more than ``THROTTLED_MESSAGES`` wait, and no more than ``limit_bytes`` unless it is a single message.
    ``dropped`` is called for each message that a newer one displaces.
    """

    def __init__(
        self,
        period_s: float,
        length: int,
        send: Callable[[Sample], None],
        dropped: Callable[[], None],
        *,
        limit_bytes: int = THROTTLED_BYTES,
    ) -> None:
        self._period_s, self._length = period_s, min(max(length, 1), THROTTLED_MESSAGES)
        self._limit_bytes = limit_bytes
        self.bytes = 0
        self._send, self._dropped = send, dropped
        self._waiting: deque[Sample] = deque()
        self._timer: asyncio.TimerHandle | None = None

    def put(self, sample: Sample) -> None:
        """Send a message, or let it wait for its time."""
        if self._timer is None:
            self._go(sample)
            return
        self.bytes += len(sample.payload)
        while self._waiting and (len(self._waiting) >= self._length or self.bytes > self._limit_bytes):
            self._take()
            self._dropped()
        self._waiting.append(sample)

    def _take(self) -> Sample:
        sample = self._waiting.popleft()
        self.bytes -= len(sample.payload)
        return sample

    def _go(self, sample: Sample) -> None:
        self._timer = asyncio.get_running_loop().call_later(self._period_s, self._next)
        self._send(sample)

    def _next(self) -> None:
        self._timer = None
        if self._waiting:
            self._go(self._take())

    def close(self) -> list[Sample]:
        """Stop sending; return what still waits."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        waiting = list(self._waiting)
        self._waiting.clear()
        self.bytes = 0
        return waiting
