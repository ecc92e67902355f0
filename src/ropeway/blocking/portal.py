"""The way from threads into an event loop: one loop in a thread of its own, for as long as somebody uses it."""

from __future__ import annotations

import asyncio
import atexit
import concurrent.futures
import contextlib
import threading
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Final, Protocol, TypeVar

from ropeway import aio
from ropeway.errors import GraphUnavailable, RopewayError, WaitTimeout

__all__ = ["STEP_S", "Portal", "portal"]

T = TypeVar("T")
A = TypeVar("A")

STEP_S: Final = 10.0  # what opening or closing one part may take; on a loaded machine it takes a tenth of a second
_LOOK_S: Final = 1.0  # after which Ctrl-C counts, should it have come in the very moment in which a wait began
_CALLBACK_THREADS: Final = 32  # callbacks that run at the same time; others wait for their turn
_CLOSED: Final = "everything that was opened in this process is closed"


class _Closable(Protocol):
    def close(self) -> None: ...


class Portal:
    """Runs coroutines for any thread, on one event loop in a thread of its own.

    The thread starts with the first user and ends with the last. Functions of programs run in other threads, so that
    they may wait, and come back here.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[_Closable, None] = {}
        self._count = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._stop: asyncio.Event | None = None
        self._pool: concurrent.futures.ThreadPoolExecutor | None = None

    def enter(self) -> None:
        """Keep the thread running for one more user."""
        with self._lock:
            if self._thread is None or not self._thread.is_alive():  # also after a fork, which copies no threads
                self._start()
            self._count += 1

    def leave(self) -> None:
        """Let one user go; the last one ends the thread."""
        with self._lock:
            self._count -= 1
            if self._count or self._loop is None or self._thread is None:
                return
            loop, thread, stop, pool = self._loop, self._thread, self._stop, self._pool
            self._loop = self._thread = self._stop = self._pool = None
        assert stop is not None
        loop.call_soon_threadsafe(stop.set)
        if thread is not threading.current_thread():
            thread.join(STEP_S)
        if pool is not None:
            pool.shutdown(wait=False)

    def keep(self, user: _Closable) -> None:
        """Close ``user`` at the end of the program, should nobody have done so by then."""
        self._open[user] = None

    def forget(self, user: _Closable) -> bool:
        """Take back ``keep``; return whether it was in force, which is true for one thread only."""
        return self._open.pop(user, self) is None

    def close_all(self) -> None:
        """Close what is open still, as far as that can be done."""
        for user in list(self._open):
            with contextlib.suppress(RopewayError):
                user.close()

    def _start(self) -> None:
        started: concurrent.futures.Future[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = (
            concurrent.futures.Future()
        )
        thread = threading.Thread(target=_run, args=(started,), name="ropeway.blocking", daemon=True)
        thread.start()
        self._loop, self._stop = started.result(STEP_S)
        self._thread, self._count = thread, 0

    def run(self, work: Callable[[], Awaitable[T]], limit_s: float | None = STEP_S) -> T:
        """Return what ``work`` gives on the loop. Ctrl-C cancels it.

        Raises ``WaitTimeout`` after ``limit_s``, ``GraphUnavailable`` if everything is closed, and ``RuntimeError`` in
        the thread of the loop itself, which would wait for itself.
        """
        loop, thread = self._loop, self._thread
        if loop is None or thread is None or not thread.is_alive():
            raise GraphUnavailable("ropeway.blocking", _CLOSED)
        if thread is threading.current_thread():
            raise RuntimeError("ropeway.blocking cannot wait in its own thread; call it from another")
        coroutine = _limited(work, limit_s)
        try:
            future = asyncio.run_coroutine_threadsafe(coroutine, loop)
        except RuntimeError:  # the loop was closed meanwhile
            coroutine.close()
            raise GraphUnavailable("ropeway.blocking", _CLOSED) from None
        try:
            return _result(future, thread)
        except concurrent.futures.CancelledError:
            raise GraphUnavailable("ropeway.blocking", _CLOSED) from None
        except BaseException:
            future.cancel()
            raise

    def wait(self, work: Callable[[], Awaitable[T]], timeout_s: float | None = 0.0) -> T:
        """Return what ``work`` gives, which may wait for others up to ``timeout_s`` and takes a step beside that."""
        return self.run(work, None if timeout_s is None else timeout_s + STEP_S)

    def call(self, function: Callable[[], T]) -> T:
        """Return what ``function`` returns, called on the loop."""

        async def work() -> T:
            return function()

        return self.run(work)

    def in_thread(self, function: Callable[[A], T]) -> Callable[[A], Coroutine[Any, Any, T]]:
        """Return a coroutine function that runs ``function`` in a thread, where it may wait."""

        async def call(argument: A) -> T:
            if self._pool is None:
                self._pool = concurrent.futures.ThreadPoolExecutor(_CALLBACK_THREADS, "ropeway.callback")
            return await asyncio.get_running_loop().run_in_executor(self._pool, function, argument)

        return call


def _result(future: concurrent.futures.Future[T], thread: threading.Thread) -> T:
    """Wait for a result of the loop in ``thread``.

    In slices: a signal that comes just before a wait does not end it, and a loop that ends may forget the newest calls.
    """
    while True:
        try:
            return future.result(_LOOK_S)
        except (TimeoutError, concurrent.futures.TimeoutError):  # not the same in Python 3.10
            if future.done():
                return future.result()
            if not thread.is_alive():
                raise GraphUnavailable("ropeway.blocking", _CLOSED) from None


async def _limited(work: Callable[[], Awaitable[T]], limit_s: float | None) -> T:
    limit = aio.timeout(limit_s)
    try:
        async with limit:
            return await work()
    except TimeoutError:
        if not limit.expired():
            raise
        assert limit_s is not None
        raise WaitTimeout("answer of the network", limit_s) from None


def _run(started: concurrent.futures.Future[tuple[asyncio.AbstractEventLoop, asyncio.Event]]) -> None:
    async def main() -> None:
        stop = asyncio.Event()
        started.set_result((asyncio.get_running_loop(), stop))
        await stop.wait()

    try:
        import uvloop
    except ImportError:  # not on every platform
        factory = None
    else:
        factory = uvloop.new_event_loop
    with aio.Runner(loop_factory=factory) as runner:  # which cancels what is left at the end
        runner.run(main())


portal = Portal()
"""The one that all graphs of ``ropeway.blocking`` share, so that a program with ten of them has one more thread."""

atexit.register(portal.close_all)
