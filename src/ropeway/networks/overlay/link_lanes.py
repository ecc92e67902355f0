"""Puts packets on several links, each in a thread of its own, so that one that takes nothing holds up no other."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import partial
from typing import Final

from ropeway.limits import OVERLAY_LINK_WAITING_BYTES

__all__ = ["LinkLanes"]

_LOOK_S: Final = 0.02  # whether to go on waiting


class LinkLanes:
    """The threads of several links, one for each link and lane. ``left_out`` counts copies by link: those that found
    too much waiting there.
    """

    def __init__(self) -> None:
        self.left_out: Counter[str] = Counter()
        self._threads: dict[tuple[str, int], ThreadPoolExecutor] = {}
        self._waiting_bytes: Counter[str] = Counter()
        self._lock = threading.Lock()

    def put(
        self, lane: int, size_bytes: int, puts: Mapping[str, Callable[[], None]], waits: Callable[[], bool]
    ) -> None:
        """Put a packet on links by name; return when one of them has taken it, or ``waits`` says no longer to wait.

        Raises what a link raised if none took it.
        """
        going = {self._hand(lane, size_bytes, name, put) for name, put in puts.items() if self._has_room(name)}
        if not going:  # full everywhere: the first is waited for
            name, put = next(iter(puts.items()))
            going = {self._hand(lane, size_bytes, name, put)}
        while True:
            done, under_way = wait(going, timeout=_LOOK_S, return_when=FIRST_COMPLETED)
            if any(future.exception() is None for future in done) or not waits():
                return
            if not under_way:
                done.pop().result()
            going = under_way or going

    def put_soon(self, lane: int, size_bytes: int, name: str, put: Callable[[], None]) -> None:
        """Put a packet on one link before all that comes later; nobody waits for it, or hears that it failed."""
        if self._has_room(name):
            self._hand(lane, size_bytes, name, put)

    def _has_room(self, name: str) -> bool:
        if self._waiting_bytes[name] <= OVERLAY_LINK_WAITING_BYTES:
            return True
        self.left_out[name] += 1
        return False

    def _hand(self, lane: int, size_bytes: int, name: str, put: Callable[[], None]) -> Future[None]:
        with self._lock:
            thread = self._threads.get((name, lane))
            if thread is None:
                thread = ThreadPoolExecutor(1, thread_name_prefix=f"overlay-{name}-{lane}")
                self._threads[name, lane] = thread
            self._waiting_bytes[name] += size_bytes
        future = thread.submit(put)
        future.add_done_callback(partial(self._landed, name, size_bytes))
        return future

    def _landed(self, name: str, size_bytes: int, _: Future[None]) -> None:
        with self._lock:
            self._waiting_bytes[name] -= size_bytes

    def close(self) -> None:
        """Put nothing more."""
        for thread in self._threads.values():
            thread.shutdown(wait=False, cancel_futures=True)
        self._threads.clear()
