"""Hands messages to Zenoh without holding up the event loop.

Zenoh takes a small message in microseconds, but waits when a link is congested, and while it takes a large one. So a
message is handed over at once while that goes quickly, and by a thread otherwise.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final

from ropeway import aio
from ropeway.limits import ZENOH_UNSENT_BYTES
from ropeway.logs import failed
from ropeway.tasks import keep_running

__all__ = ["Sender", "ZenohLane"]

log = logging.getLogger("ropeway.zenoh")

_LARGE_BYTES: Final = 32 << 10  # takes Zenoh longer than the thread takes to wake up
_SLOW_S: Final = 0.002  # after which a link counts as congested
_FINISH_S: Final = 2.0  # how long what waits may take when its publisher closes
_CLOSE_S: Final = 5.0

Put = Callable[[], object]
"""Hands one message to Zenoh."""


class ZenohLane:
    """Keeps what waits for the network on behalf of one publisher, client or service, oldest first.

    ``depth`` bounds the number; ``on_lost`` is told on the event loop how many were given up.
    """

    def __init__(self, on_lost: Callable[[int], None], depth: int | None = None) -> None:
        self.waiting: deque[tuple[Put, int]] = deque()
        self.bytes = 0
        self.queued = False
        self.closed = False
        self.on_lost = on_lost
        self._depth = depth

    def add(self, put: Put, size: int) -> int:
        """Add one, and return how many had to go for it."""
        self.waiting.append((put, size))
        self.bytes += size
        lost = 0
        while len(self.waiting) > 1 and (self.bytes > ZENOH_UNSENT_BYTES or self._is_full()):
            self.bytes -= self.waiting.popleft()[1]
            lost += 1
        return lost

    def _is_full(self) -> bool:
        return self._depth is not None and len(self.waiting) > self._depth


class Sender:
    """Sends what the lanes of a graph have, those that wait in turn."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._loop = asyncio.get_running_loop()
        self._change = threading.Condition()
        self._turns: deque[ZenohLane] = deque()
        self._busy: ZenohLane | None = None
        self._congested = False
        self._stopping = threading.Event()
        self._finished: dict[ZenohLane, asyncio.Event] = {}
        self._thread = threading.Thread(
            target=keep_running, args=(self._run, f"{name}: sending", self._stopping), name="zenoh-send", daemon=True
        )
        self._thread.start()

    def send(self, lane: ZenohLane, put: Put, size: int) -> None:
        """Hand a message of ``size`` bytes to Zenoh, now or soon; one that Zenoh refuses is told as lost."""
        if size < _LARGE_BYTES and not self._congested and not lane.queued:
            began = time.perf_counter()
            self._attempt(lane, put)
            self._congested = time.perf_counter() - began > _SLOW_S
            return
        with self._change:
            lost = lane.add(put, size)
            if not lane.queued:
                lane.queued = True
                self._turns.append(lane)
            self._change.notify()
        if lost:
            lane.on_lost(lost)

    async def finish(self, lane: ZenohLane) -> None:
        """Wait until what a lane has was sent, two seconds at most; the rest is given up and told as lost."""
        with self._change:
            gone = self._finished.setdefault(lane, asyncio.Event()) if lane.queued else None
        if gone is not None:
            with contextlib.suppress(TimeoutError):
                async with aio.timeout(_FINISH_S):
                    await gone.wait()
        with self._change:
            self._finished.pop(lane, None)
            lost = len(lane.waiting)
            lane.waiting.clear()
            lane.bytes = 0
            lane.closed = True
        if lost:
            lane.on_lost(lost)

    async def close(self) -> None:
        """End the thread."""
        self._stopping.set()
        with self._change:
            self._change.notify()
        await asyncio.to_thread(self._thread.join, _CLOSE_S)
        if self._thread.is_alive():
            log.warning("%s: Zenoh still holds a message after %g s", self._name, _CLOSE_S)

    def _attempt(self, lane: ZenohLane, put: Put) -> None:
        try:
            put()
        except Exception:  # Zenoh has errors of its own kind, and a session that was closed is one
            failed(log, "%s: a message was not sent", self._name)
            self._call(lane.on_lost, 1)

    def _call(self, function: Callable[[int], None], value: int) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has closed
            self._loop.call_soon_threadsafe(function, value)

    def _run(self) -> None:
        """Send, in the thread."""
        while True:
            with self._change:
                while not self._turns:
                    self._congested = False
                    if self._stopping.is_set():
                        return
                    self._change.wait()
                lane = self._turns.popleft()
                put, size = lane.waiting.popleft() if lane.waiting else (None, 0)
                lane.bytes -= size
            if put is not None:
                self._attempt(lane, put)
            with self._change:
                if lane.waiting and not self._stopping.is_set():
                    self._turns.append(lane)
                    continue
                lane.queued = False
                gone = self._finished.get(lane)
            if gone is not None:
                with contextlib.suppress(RuntimeError):
                    self._loop.call_soon_threadsafe(gone.set)
