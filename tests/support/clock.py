"""Clocks that a busy machine does not disturb: an event loop whose time jumps, and the time a thread was held up."""

from __future__ import annotations

import asyncio
import selectors
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeVar

__all__ = ["JumpingLoop", "Stopwatch", "held_up", "queued_s"]

_T = TypeVar("_T")
_DELIVERY_S: Final = 0.02
"""What was written to a socket of this process is there at once, on a busy machine a little later."""


class JumpingLoop(asyncio.SelectorEventLoop):
    """An event loop that does not wait: where nothing is to do, its time jumps to the next timer.

    What runs on it takes no time of the loop, so that a test can say exactly when something happens. Sockets of this
    process and executors are waited for; other processes, threads and ``time.monotonic`` know nothing of its time.
    """

    def __init__(self) -> None:
        self._now_s = 0.0
        super().__init__(_Selector(self))
        self.errands = 0
        """Calls that an executor still has to answer; they take real time, so nothing jumps meanwhile."""

    def time(self) -> float:
        """Return the seconds since the loop was made, as its timers count them."""
        return self._now_s

    def jump(self, seconds: float) -> None:
        """Let so much time pass."""
        self._now_s += seconds

    def run_in_executor(  # type: ignore[override]  # typeshed's has a TypeVarTuple, and we know no more than it
        self, executor: Executor | None, func: Callable[..., _T], *args: Any
    ) -> asyncio.Future[_T]:
        """Run something in a thread, and let no time pass until it has ended."""
        future: asyncio.Future[_T] = super().run_in_executor(executor, func, *args)
        self.errands += 1
        future.add_done_callback(self._returned)
        return future

    async def shutdown_default_executor(self, timeout: float | None = None) -> None:
        """Wait for the threads of the executor; the time that they may take would be over at once."""
        await super().shutdown_default_executor()

    def _returned(self, _: object) -> None:
        self.errands -= 1


class _Selector(selectors.DefaultSelector):
    """Looks for what is ready; where nothing is, the loop jumps as far as it would have waited."""

    def __init__(self, loop: JumpingLoop) -> None:
        super().__init__()
        self._loop = loop

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Return what is ready."""
        if timeout is None or timeout <= 0:
            return super().select(timeout)
        if self._loop.errands:
            return super().select(None)
        ready = super().select(_DELIVERY_S if len(self.get_map()) > 1 else 0)  # the first is the loop's own
        if not ready:
            self._loop.jump(timeout)
        return ready


class Stopwatch:
    """The time that passed on the running loop since it was made."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._began_s = self._loop.time()

    @property
    def seconds(self) -> float:
        """How long it has run, to the microsecond."""
        return round(self._loop.time() - self._began_s, 6)


@contextmanager
def held_up() -> Iterator[Callable[[], float]]:
    """Measure for how many seconds the code inside waited for something; waiting for a processor does not count."""
    began_s, busy_s = time.monotonic(), sum(_ran_and_queued_s("thread-self"))
    yield lambda: (time.monotonic() - began_s) - (sum(_ran_and_queued_s("thread-self")) - busy_s)


def queued_s(task: int | str = "thread-self") -> float:
    """Return how long a thread (a process: its first) has waited for a processor so far, while others had them all."""
    return _ran_and_queued_s(task)[1]


def _ran_and_queued_s(task: int | str) -> tuple[float, float]:
    try:
        ran_ns, queued_ns, _ = Path(f"/proc/{task}/schedstat").read_text().split()
    except FileNotFoundError:  # a kernel that does not count it
        return time.thread_time() if task == "thread-self" else 0.0, 0.0
    return int(ran_ns) / 1e9, int(queued_ns) / 1e9
