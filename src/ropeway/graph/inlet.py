"""Hands items over from Zenoh's threads to the event loop: bounded, in batches and in order."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Final, Generic, TypeVar

from ropeway.limits import OVERLAY_WAITING_NOTES_BYTES

__all__ = ["Inlet", "one_by_one"]

log = logging.getLogger("ropeway.overlay")

_ITEM_BYTES: Final = 256  # what an item costs beside its size

T = TypeVar("T")


class Inlet(Generic[T]):
    """Takes from any thread, gives on the loop.

    ``limit_bytes`` bounds what may wait for the loop. Above, the oldest goes, but for the last: ``on_lost`` is called
    with it, in the thread that put something, and has to let go of it.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        deliver: Callable[[list[T]], None],
        *,
        limit_bytes: int = OVERLAY_WAITING_NOTES_BYTES,
        on_lost: Callable[[T], None] | None = None,
    ) -> None:
        self.lost = 0
        self.closed = False
        self._loop, self._deliver = loop, deliver
        self._limit_bytes, self._on_lost = limit_bytes, on_lost
        self._waiting: deque[tuple[T, int]] = deque()
        self._bytes = 0
        self._scheduled = False
        self._lock = threading.Lock()

    @property
    def waiting_bytes(self) -> int:
        """Return how much waits for the loop."""
        return self._bytes

    def put(self, item: T, size: int = 0) -> None:
        """Hand over one item of ``size`` bytes; from any thread."""
        if self.closed:
            return
        lost: list[T] = []
        with self._lock:
            self._waiting.append((item, size + _ITEM_BYTES))
            self._bytes += size + _ITEM_BYTES
            while self._bytes > self._limit_bytes and len(self._waiting) > 1:
                oldest, oldest_size = self._waiting.popleft()
                self._bytes -= oldest_size
                lost.append(oldest)
            self.lost += len(lost)
            schedule, self._scheduled = not self._scheduled, True
        if schedule:
            with contextlib.suppress(RuntimeError):  # the loop has closed
                self._loop.call_soon_threadsafe(self._give)
        if self._on_lost is not None:
            for oldest in lost:
                self._on_lost(oldest)

    def _give(self) -> None:
        with self._lock:
            self._scheduled = False
            batch = [item for item, _ in self._waiting]
            self._waiting.clear()
            self._bytes = 0
        if batch and not self.closed:
            self._deliver(batch)


def one_by_one(take: Callable[[T], None]) -> Callable[[list[T]], None]:
    """Return what takes a batch one by one; an item that fails costs the others nothing."""

    def deliver(batch: list[T]) -> None:
        for item in batch:
            try:
                take(item)
            except Exception:  # of one note or request
                log.exception("overlay: received data could not be delivered")

    return deliver
