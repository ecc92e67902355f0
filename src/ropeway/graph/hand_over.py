"""Hands over from a thread that waits for a network to the event loop."""

from __future__ import annotations

import asyncio
import logging
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any, Final

__all__ = ["HandOver"]

log = logging.getLogger("ropeway.graph")

_LIMIT_SAMPLES: Final = 4096  # as many as the loop takes in some ten milliseconds
_LIMIT_BYTES: Final = 32 << 20


class HandOver(ABC):
    """Runs functions of the event loop with what a thread pushes, in batches and in order.

    However many batches are pushed, at most one wake-up of the loop is under way. What waits for the loop is bounded in
    samples and bytes: beyond the bound ``room`` is false, and the thread leaves the rest with the network. A thread
    that found no room sets ``_starved``; it is woken with ``_wake`` when the loop has caught up.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._loop = asyncio.get_running_loop()
        self._stopping = False
        self._starved = False
        self._out: deque[tuple[Callable[[list[Any]], None], list[Any], int, int]] = deque()
        self._scheduled = False
        self._pushed_samples = self._pushed_bytes = 0  # changed by the thread alone
        self._drained_samples = self._drained_bytes = 0  # changed by the loop alone

    @abstractmethod
    def _wake(self) -> None:
        """Wake the thread."""

    @property
    def room(self) -> bool:
        """Whether more may be pushed."""
        samples, size = self.space()
        return samples > 0 and size > 0

    def space(self) -> tuple[int, int]:
        """Return how many more samples and bytes may be pushed."""
        return (
            _LIMIT_SAMPLES - self._pushed_samples + self._drained_samples,
            _LIMIT_BYTES - self._pushed_bytes + self._drained_bytes,
        )

    def push(self, function: Callable[[list[Any]], None], batch: list[Any], samples: int = 0, size: int = 0) -> None:
        """Run ``function(batch)`` on the loop; batches pushed for one function are joined while they wait.

        Other threads may push, too, what does not count: no ``samples`` and no ``size``.
        """
        if samples or size:
            self._pushed_samples += samples
            self._pushed_bytes += size
        self._out.append((function, batch, samples, size))
        if not self._scheduled:
            self._scheduled = True
            try:
                self._loop.call_soon_threadsafe(self._drain)
            except RuntimeError:  # the loop was closed under an open graph
                self._stopping = True

    def _drain(self) -> None:
        self._scheduled = False
        out = self._out
        joined: dict[Callable[[list[Any]], None], list[Any]] = {}
        samples = size = 0
        for _ in range(len(out)):
            function, batch, count, byte_count = out.popleft()
            samples += count
            size += byte_count
            known = joined.get(function)
            if known is None:
                joined[function] = batch
            else:
                known.extend(batch)
        for function, batch in joined.items():
            try:
                function(batch)
            except Exception:  # of one taker; the others get what is theirs
                log.exception("%s: delivering %d items failed", self._name, len(batch))
        self._drained_samples += samples
        self._drained_bytes += size
        if self._starved and not self._stopping:
            self._wake()
