"""Runs background tasks: none dies unnoticed, and each is ended properly, even if its owner is cancelled meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
import weakref
from collections.abc import Callable, Coroutine
from typing import Any, Final, TypeVar

from ropeway import aio
from ropeway.aio import BaseExceptionGroup
from ropeway.errors import RopewayError

__all__ = [
    "Chores",
    "Interruptible",
    "Supervised",
    "background",
    "describe",
    "end",
    "failing",
    "keep_running",
    "settled",
    "tell_failure",
]

log = logging.getLogger("ropeway.tasks")

_T = TypeVar("_T")
Work = Callable[[], Coroutine[Any, Any, None]]

_PAUSE_S: Final = 1.0  # long enough that a failure at every attempt costs next to nothing
_LONGEST_PAUSE_S: Final = 30.0  # short enough that what mends itself is back before anybody has looked for it


def describe(error: BaseException) -> str:
    """Return an error as one line: its text alone where the text was written for users, else with its kind."""
    if isinstance(error, BaseExceptionGroup):
        return "; ".join(dict.fromkeys(map(describe, error.exceptions)))
    text = " ".join(str(error).split())
    return text if text and isinstance(error, RopewayError) else f"{type(error).__name__}: {text}".removesuffix(": ")


class _Attempts:
    """The attempts at one piece of work: how they failed, and how long to wait before the next."""

    def __init__(self, name: str, pause_s: float, longest_pause_s: float) -> None:
        self.name = name
        self.error, self.failures = "", 0
        self._first_s, self._pause_s, self._longest_s = pause_s, pause_s, longest_pause_s
        self._said = ""
        self._began = 0.0

    def begin(self) -> None:
        """Record that another attempt begins."""
        self.error = ""
        self._began = time.monotonic()
        _failing.pop(self, None)

    def failed(self, error: BaseException) -> float:
        """Tell why it failed; return how long to wait, in seconds."""
        if time.monotonic() - self._began > self._longest_s:
            self._pause_s = self._first_s
        pause_s, self._pause_s = self._pause_s, min(2 * self._pause_s, self._longest_s)
        self.failures += 1
        self.error = describe(error)
        _failing[self] = None
        level = logging.DEBUG if self.error == self._said else logging.ERROR
        self._said = self.error
        log.log(level, "%s failed: %s; it is started again in %g s", self.name, self.error, pause_s, exc_info=error)
        return pause_s

    def end(self) -> None:
        """Record that no more attempts follow."""
        _failing.pop(self, None)


_failing: dict[_Attempts, None] = {}


def failing() -> list[dict[str, Any]]:
    """Return the background work of this process that has failed and waits to be started again, as JSON."""
    return [{"task": work.name, "error": work.error, "failures": work.failures} for work in list(_failing)]


def keep_running(
    work: Callable[[], None],
    name: str,
    stopping: threading.Event,
    *,
    pause_s: float = _PAUSE_S,
    longest_pause_s: float = _LONGEST_PAUSE_S,
) -> None:
    """Run ``work`` in this thread until it returns, or ``stopping`` is set while it waits to be started again.

    See ``Supervised``, which does the same for tasks.
    """
    attempts = _Attempts(name, pause_s, longest_pause_s)
    while True:
        attempts.begin()
        try:
            work()
        except Exception as error:  # it is noted, and the work begun again
            if not stopping.wait(attempts.failed(error)):
                continue
        attempts.end()
        return


class Supervised:
    """Keeps background work running for as long as its owner wants, whatever happens to it.

    If it raises, the failure is logged, ``error`` says why, and the work is started again after a pause that doubles
    from ``pause_s`` to ``longest_pause_s``. Work that returns is done. ``work`` is called in ``start``, before anything
    else runs, so that what its arguments subscribe to is heard from then on. ``on_failure``, which must not raise, is
    told of each failure.
    """

    def __init__(
        self,
        work: Work,
        name: str,
        *,
        on_failure: Callable[[BaseException], None] | None = None,
        pause_s: float = _PAUSE_S,
        longest_pause_s: float = _LONGEST_PAUSE_S,
    ) -> None:
        self._work, self._on_failure = work, on_failure
        self._attempts = _Attempts(name, pause_s, longest_pause_s)
        self._next: Coroutine[Any, Any, None] | None = None
        self._task: asyncio.Task[None] | None = None

    @property
    def error(self) -> str:
        """Return why it does not run, ``""`` while it does."""
        return self._attempts.error

    @property
    def failures(self) -> int:
        """Return how often it has failed."""
        return self._attempts.failures

    def start(self) -> Supervised:
        """Begin; return the object itself."""
        assert self._task is None
        with contextlib.suppress(Exception):  # it is called again, where its failure is seen
            self._next = self._work()
        self._task = asyncio.create_task(self._run(), name=self._attempts.name)
        return self

    async def wait(self) -> None:
        """Wait until the work is done, or was ended."""
        if self._task is not None:
            await asyncio.wait({self._task})

    async def close(self) -> None:
        """End it."""
        await end(self)

    def release(self) -> asyncio.Task[None] | None:
        """Let go of the task, for ``end``."""
        task, self._task = self._task, None
        self._attempts.end()
        if self._next is not None:  # it is ended before its first step
            self._next.close()
            self._next = None
        return task

    async def _run(self) -> None:
        while True:
            self._attempts.begin()
            try:
                work, self._next = self._next or self._work(), None
                await work
            except (asyncio.CancelledError, KeyboardInterrupt, SystemExit):
                raise
            except BaseException as error:  # a panic of a library that is not in Python is no Exception
                pause_s = self._attempts.failed(error)
                if self._on_failure is not None:
                    self._on_failure(error)
            else:
                return
            await asyncio.sleep(pause_s)


def background(work: Coroutine[Any, Any, _T], name: str) -> asyncio.Task[_T]:
    """Begin work that nobody waits for, and return its task; if it fails, that is logged at once.

    The owner keeps the task and ends it with ``end``. Work that has to go on after a failure is ``Supervised``.
    """
    task = asyncio.create_task(work, name=name)
    task.add_done_callback(tell_failure)
    return task


def tell_failure(task: asyncio.Task[Any]) -> None:
    """Log how a task failed, as its callback for when it is done; ``end`` then does not tell it again."""
    if not task.cancelled() and (error := task.exception()) is not None:
        _told.add(task)
        log.error("%s failed: %s", task.get_name(), describe(error), exc_info=error)


_told: weakref.WeakSet[asyncio.Task[Any]] = weakref.WeakSet()  # tasks whose failure is in the log


class Chores:
    """Tasks that end by themselves, each on its own: one that fails is logged at once, and costs the others nothing."""

    def __init__(self) -> None:
        self.failures = 0
        self.tasks: set[asyncio.Task[Any]] = set()
        """The tasks that are under way."""

    def start(self, work: Coroutine[Any, Any, Any], name: str) -> asyncio.Task[Any]:
        """Begin one."""
        task = asyncio.get_running_loop().create_task(work, name=name)
        self.tasks.add(task)
        task.add_done_callback(self._done)
        return task

    def cancel(self) -> None:
        """Cancel the chores under way."""
        for task in self.tasks:
            task.cancel()

    async def wait(self, timeout_s: float | None = None) -> None:
        """Wait until those that are under way are done, or the time is over."""
        if self.tasks:
            await asyncio.wait(self.tasks, timeout=timeout_s)

    async def close(self) -> None:
        """End those that are under way, but for the one that asks."""
        ending = [task for task in self.tasks if task is not asyncio.current_task()]
        for task in ending:
            task.cancel()
        if ending:
            await asyncio.wait(ending)

    def _done(self, task: asyncio.Task[Any]) -> None:
        self.tasks.discard(task)
        if not task.cancelled() and task.exception() is not None:
            self.failures += 1
            tell_failure(task)


async def settled(future: asyncio.Future[Any], timeout_s: float | None = None) -> bool:
    """Wait until a future is done, at most so long, and return whether it is. It goes on if its waiter is cancelled.

    The same as ``asyncio.wait`` for one future, at a third of the calls. Like that it takes a turn of the event loop
    even where the future is done, so that what was handed over before it comes first.
    """
    loop = asyncio.get_running_loop()
    waiter: asyncio.Future[None] = loop.create_future()

    def wake(_: object = None) -> None:
        if not waiter.done():
            waiter.set_result(None)

    expiry = loop.call_later(max(timeout_s, 0.0), wake) if timeout_s is not None else None
    future.add_done_callback(wake)
    try:
        await waiter
    finally:
        future.remove_done_callback(wake)
        if expiry is not None:
            expiry.cancel()
    return future.done()


async def end(*tasks: asyncio.Task[Any] | Supervised | None) -> None:
    """Cancel tasks and wait until they are done; a failure of theirs that nobody saw goes to the loop's handler.

    Awaiting a cancelled task with its ``CancelledError`` suppressed would swallow a cancellation of the caller, too.
    """
    found = (task.release() if isinstance(task, Supervised) else task for task in tasks)
    ending = [task for task in found if task is not None]
    for task in ending:
        task.cancel()
    if ending:
        await asyncio.wait(ending)
    for task in ending:
        if not task.cancelled() and task not in _told and (error := task.exception()) is not None:
            context = {"message": f"{task.get_name()} failed", "exception": error, "task": task}
            asyncio.get_running_loop().call_exception_handler(context)


class Interruptible:
    """A block that others can end with an error of their choice, as ``asyncio.timeout`` ends one when time is over.

    Cheaper than a task of its own. ``interrupt`` may be called at any time; only the first counts, and only while the
    block runs. A cancellation of the task from elsewhere stays a cancellation.
    """

    _task: asyncio.Task[Any] | None = None
    _error: Exception | None = None
    _cancelling = 0

    @property
    def mine(self) -> bool:
        """Whether the caller runs in this block."""
        return self._task is not None and self._task is asyncio.current_task()

    def interrupt(self, error: Exception) -> None:
        """Raise ``error`` in the block where it waits."""
        if self._task is not None and self._error is None:
            self._error = error
            self._task.cancel()

    def __enter__(self) -> Interruptible:
        task = asyncio.current_task()
        assert task is not None
        self._task, self._cancelling = task, aio.cancelling(task)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        task, self._task = self._task, None
        assert task is not None
        if self._error is None or aio.uncancel(task) > self._cancelling:
            return
        if kind is None or issubclass(kind, asyncio.CancelledError):
            raise self._error from None
