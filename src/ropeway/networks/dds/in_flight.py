"""Limits how many requests wait at a server: ROS 2 nodes keep ten, and drop the oldest silently."""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from typing import Final

__all__ = ["InFlightRequests"]

_MAX: Final = 512
_UNKNOWN_DEPTH: Final = 10  # of services, unless a node says otherwise
_PATIENCE_S: Final = 1.0
_DEFERRED_PATIENCE_S: Final = 0.05
_FORGET: Final = 0.9


class InFlightRequests:
    """Lets a burst of requests out as fast as they are answered.

    Half of what the server keeps is used, since others call it, too. A server may take requests and answer them much
    later; so where nothing is answered for a second (or for twice what answers took lately), the oldest request counts
    no longer. ``deferred`` is for services that are made that way, as the one that gives the result of a goal.
    """

    def __init__(self, *, deferred: bool = False) -> None:
        self._deferred = deferred
        self._limit = self._of(0)
        self._out: OrderedDict[int, float] = OrderedDict()
        self._next = 0
        self._queue: deque[asyncio.Future[None]] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._progress = 0.0
        self._slowest_s = 0.0

    @staticmethod
    def _of(depth: int) -> int:
        return min(max((depth or _UNKNOWN_DEPTH) // 2, 1), _MAX)

    def resize(self, depth: int) -> None:
        """Set the smallest number of requests that any server keeps; 0 if none announces it."""
        self._limit = self._of(depth)
        self._admit()

    def close(self) -> None:
        """Let everybody in: there is nothing to wait for any more."""
        self._limit = 1 << 30
        if self._timer is not None:
            self._timer.cancel()
        self._admit()

    def try_enter(self, *, waited: bool = False) -> int:
        """Return the ticket for ``leave``, or 0 where ``enter`` has to wait; it may not have to twice."""
        if not waited and (self._queue or len(self._out) >= self._limit):
            return 0
        self._next += 1
        now = asyncio.get_running_loop().time()
        if not self._out:
            self._progress = now
        self._out[self._next] = now
        if self._queue:
            self._admit()
        return self._next

    async def enter(self) -> int:
        """Wait for room; return the ticket for ``leave``."""
        if ticket := self.try_enter():
            return ticket
        place: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._queue.append(place)
        self._arm()
        try:
            await place
        except asyncio.CancelledError:
            if place in self._queue:
                self._queue.remove(place)
            else:  # let in and cancelled at once
                self._admit()
            raise
        return self.try_enter(waited=True)

    def leave(self, ticket: int, *, answered: bool) -> None:
        """Note that a request was answered, or is no longer waited for."""
        now = asyncio.get_running_loop().time()
        began = self._out.pop(ticket, None)
        if answered:
            self._progress = now
            if began is not None:
                self._slowest_s = max(self._slowest_s * _FORGET, now - began)
        if self._queue:
            self._admit()

    def _admit(self) -> None:
        """Let in the first in the queue; who enters lets in the next."""
        while self._queue and len(self._out) < self._limit:
            place = self._queue.popleft()
            if not place.done():
                place.set_result(None)
                return

    def _arm(self) -> None:
        if self._timer is None:
            loop = asyncio.get_running_loop()
            due = 0.0 if self._deferred else self._progress + self._patience_s
            self._timer = loop.call_at(max(due, loop.time() + _DEFERRED_PATIENCE_S), self._on_time)

    @property
    def _patience_s(self) -> float:
        return max(_PATIENCE_S, 2 * self._slowest_s)

    def _on_time(self) -> None:
        self._timer = None
        if not self._queue:
            return
        now = asyncio.get_running_loop().time()
        if self._deferred:
            self._out.clear()
        elif now - self._progress >= self._patience_s and self._out:
            self._out.popitem(last=False)
            self._progress = now
        self._admit()
        self._arm()
