"""Threads that publish and answer, because the middleware may block a writer until a slow reader catches up.

Each publisher, client and service has a ``Lane``: what it sends goes out in order. A few threads serve all lanes, so
that one slow reader delays its own topic only.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import queue
import threading
from collections import deque
from collections.abc import Callable
from typing import Final

__all__ = ["Lane", "Senders"]

log = logging.getLogger("ropeway.ros2")

_THREADS: Final = 8
_IN_A_ROW: Final = 32  # of one lane, before the next lane has its turn
_STOP_S: Final = 2.0


class Lane:
    """Sends the messages of one part, in order. More than ``messages`` or ``size`` bytes do not wait: the oldest goes.

    ``dropped`` is called on the thread of ``put`` with how many went.
    """

    def __init__(self, senders: Senders, messages: int, size: int, dropped: Callable[[int], None]) -> None:
        self._senders = senders
        self._messages, self._size = messages, size
        self._dropped = dropped
        self._lock = threading.Lock()
        self._waiting: deque[tuple[Callable[[], None], int]] = deque()
        self._waiting_bytes = 0
        self._busy = False

    def put(self, errand: Callable[[], None], size: int = 0) -> None:
        """Run ``errand``, which must not raise, after those before it."""
        lost = 0
        with self._lock:
            self._waiting.append((errand, size))
            self._waiting_bytes += size
            while len(self._waiting) > 1 and (len(self._waiting) > self._messages or self._waiting_bytes > self._size):
                self._waiting_bytes -= self._waiting.popleft()[1]
                lost += 1
            wake, self._busy = not self._busy, True
        if lost:
            self._dropped(lost)
        if wake:
            self._senders.serve(self)

    async def finish(self, errand: Callable[[], None]) -> None:
        """Run ``errand`` after those before it and wait for it, or until a reader holds things up for too long."""
        loop = asyncio.get_running_loop()
        done: asyncio.Future[None] = loop.create_future()

        def last() -> None:
            try:
                errand()
            finally:
                with contextlib.suppress(RuntimeError):  # the loop closed first
                    loop.call_soon_threadsafe(_resolve, done)

        self.put(last)
        await asyncio.wait({done}, timeout=_STOP_S)

    def run(self) -> bool:
        """Run some errands, in a thread; true if more are left."""
        for _ in range(_IN_A_ROW):
            with self._lock:
                if not self._waiting:
                    self._busy = False
                    return False
                errand, size = self._waiting.popleft()
                self._waiting_bytes -= size
            try:
                errand()
            except Exception:  # of one message; the lane goes on
                log.exception("sending failed")
        return True


class Senders:
    """The threads of one graph; they start when they are needed."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._ready: queue.SimpleQueue[Lane | None] = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._idle = 0
        self._lock = threading.Lock()
        self._stopping = False

    def lane(self, messages: int, size: int, dropped: Callable[[int], None]) -> Lane:
        """Make a lane for one part."""
        return Lane(self, messages, size, dropped)

    def serve(self, lane: Lane) -> None:
        """Schedule the lane for a thread."""
        with self._lock:
            if self._stopping:
                return
            if self._idle <= self._ready.qsize() and len(self._threads) < _THREADS:
                name = f"ropeway {self._name} sender {len(self._threads)}"
                thread = threading.Thread(target=self._main, name=name, daemon=True)
                self._threads.append(thread)
                thread.start()
        self._ready.put(lane)

    async def stop(self) -> None:
        """Run what waits and end the threads; one that the middleware holds for longer is left behind."""
        with self._lock:
            self._stopping = True
            threads = list(self._threads)
        for _ in threads:
            self._ready.put(None)
        if not threads:
            return
        loop = asyncio.get_running_loop()
        ended = loop.create_future()

        def join() -> None:
            for thread in threads:
                thread.join()
            with contextlib.suppress(RuntimeError):  # the loop closed first
                loop.call_soon_threadsafe(_resolve, ended)

        joiner = threading.Thread(target=join, name=f"ropeway {self._name} end", daemon=True)
        joiner.start()
        done, _ = await asyncio.wait({ended}, timeout=_STOP_S)
        if done:
            joiner.join()
        else:
            log.warning("%s: a reader blocks what was published last, which is dropped", self._name)

    def _main(self) -> None:
        while True:
            with self._lock:
                self._idle += 1
            lane = self._ready.get()
            with self._lock:
                self._idle -= 1
            if lane is None:
                return
            try:
                more = lane.run()
                while more and self._stopping:
                    more = lane.run()
            except Exception:  # of one lane; the others send as ever
                log.exception("%s: sending failed", self._name)
                more = True
            if more:
                self._ready.put(lane)


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
