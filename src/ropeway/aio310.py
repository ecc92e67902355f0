"""Structured concurrency for Python 3.10, with the meaning that asyncio gives it from 3.11 on; see ``ropeway.aio``.

Tasks of Python 3.10 do not count the cancellations asked of them, so a time limit could not tell its own from somebody
else's. Here a task counts from the moment that a limit or a group first looks at it, which is all that they compare.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import threading
import weakref
from collections.abc import Callable, Coroutine
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any, Final, TypeVar

from exceptiongroup import BaseExceptionGroup

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Runner", "TaskGroup", "Timeout", "cancelling", "timeout", "timeout_at", "uncancel"]

T = TypeVar("T")

_REQUESTS: Final = "_ropeway_cancel_requests"  # the attribute of a task that counts


def cancelling(task: asyncio.Task[Any]) -> int:
    """Return how many cancellations of the task were asked for and not taken back, since it was first looked at."""
    requests: int | None = getattr(task, _REQUESTS, None)
    if requests is None:
        requests = 0
        setattr(task, _REQUESTS, requests)
        task.cancel = _counting(task)  # type: ignore[method-assign, assignment]
    return requests


def uncancel(task: asyncio.Task[Any]) -> int:
    """Take back one request to cancel the task, and return how many are left."""
    left = max(0, cancelling(task) - 1)
    setattr(task, _REQUESTS, left)
    return left


def _counting(task: asyncio.Task[Any]) -> Callable[[Any], bool]:
    """Return the task's ``cancel``, but one that counts; it does not keep the task alive."""
    known = weakref.ref(task)

    def cancel(msg: Any = None) -> bool:
        task = known()
        if task is None or task.done():
            return False
        setattr(task, _REQUESTS, getattr(task, _REQUESTS) + 1)
        return type(task).cancel(task, msg)

    return cancel


def _this_task() -> asyncio.Task[Any]:
    task = asyncio.current_task()
    if task is None:
        raise RuntimeError("this works inside of a task only")
    return task


class Timeout:
    """A block that is cancelled at ``when`` of the loop's clock and then raises ``TimeoutError``; ``None`` is never."""

    def __init__(self, when: float | None) -> None:
        self._when = when
        self._handle: asyncio.TimerHandle | asyncio.Handle | None = None
        self._task: asyncio.Task[Any] | None = None
        self._before = 0
        self._expired = False

    def when(self) -> float | None:
        """Return when it ends."""
        return self._when

    def expired(self) -> bool:
        """Return whether the time was over before the block was."""
        return self._expired

    def reschedule(self, when: float | None) -> None:
        """End the block at another time."""
        if self._task is None:
            raise RuntimeError("the block has not begun, or is over")
        if self._handle is not None:
            self._handle.cancel()
        self._when, self._handle = when, None
        if when is not None:
            loop = asyncio.get_running_loop()
            late = when <= loop.time()
            self._handle = loop.call_soon(self._expire) if late else loop.call_at(when, self._expire)

    async def __aenter__(self) -> Self:
        self._task = _this_task()
        self._before = cancelling(self._task)
        self.reschedule(self._when)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        task, self._task = self._task, None
        assert task is not None
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None
        if self._expired and uncancel(task) <= self._before and isinstance(error, asyncio.CancelledError):
            raise TimeoutError from error

    def _expire(self) -> None:
        assert self._task is not None
        self._handle, self._expired = None, True
        self._task.cancel()


def timeout(delay_s: float | None) -> Timeout:
    """Return a block that is given so many seconds from now."""
    return timeout_at(None if delay_s is None else asyncio.get_running_loop().time() + delay_s)


def timeout_at(when: float | None) -> Timeout:
    """Return a block that ends at ``when`` of the loop's clock."""
    return Timeout(when)


class TaskGroup:
    """A block that ends when all tasks made in it are done; the first that fails ends the others, and the block."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[Any]] = set()
        self._errors: list[BaseException] = []
        self._parent: asyncio.Task[Any] | None = None
        self._before = 0
        self._in_block = False
        self._ending = False
        self._interrupted = False  # the block was cancelled by the group itself

    def create_task(
        self, coroutine: Coroutine[Any, Any, T], *, name: str | None = None, context: None = None
    ) -> asyncio.Task[T]:
        """Begin a task of the group."""
        if self._parent is None or self._ending or (not self._in_block and not self._tasks):
            coroutine.close()
            raise RuntimeError("the group has not begun, or is over")
        task = asyncio.create_task(coroutine, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._done)
        return task

    async def __aenter__(self) -> Self:
        self._parent = _this_task()
        self._before = cancelling(self._parent)
        self._in_block = True
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._parent is not None
        self._in_block = False
        cancelled = error if isinstance(error, asyncio.CancelledError) else None
        if self._interrupted and uncancel(self._parent) <= self._before:
            cancelled = None  # it was the group that cancelled the block, and nobody else
        if error is not None:
            self._end()
        while self._tasks:
            try:
                await asyncio.wait(self._tasks)
            except asyncio.CancelledError as more:
                cancelled = more
                self._end()
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise error
        if error is not None and not isinstance(error, asyncio.CancelledError):
            self._errors.append(error)
        if cancelled is not None and not self._errors:
            raise cancelled
        if self._errors:
            errors, self._errors = self._errors, []
            raise BaseExceptionGroup("unhandled errors in a TaskGroup", errors) from None

    def _end(self) -> None:
        self._ending = True
        for task in self._tasks:
            task.cancel()

    def _done(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if task.cancelled() or (error := task.exception()) is None:
            return
        self._errors.append(error)
        if not self._ending:
            self._end()
            if self._in_block:
                assert self._parent is not None
                self._interrupted = True
                self._parent.cancel()


class Runner:
    """Runs coroutines on one loop of its own; Ctrl-C cancels what runs, and then raises ``KeyboardInterrupt``."""

    def __init__(self, *, loop_factory: Callable[[], asyncio.AbstractEventLoop] | None = None) -> None:
        self._factory = loop_factory or asyncio.new_event_loop
        self._loop: asyncio.AbstractEventLoop | None = None
        self._interrupts = 0

    def __enter__(self) -> Self:
        self.get_loop()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def get_loop(self) -> asyncio.AbstractEventLoop:
        """Return the loop, which is made when it is first asked for."""
        if self._loop is None:
            self._loop = self._factory()
        return self._loop

    def run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Return the result of the coroutine."""
        loop = self.get_loop()
        asyncio.set_event_loop(loop)
        task = loop.create_task(coroutine)
        cancelling(task)  # it counts from the beginning
        self._interrupts = 0
        with self._signals(task):
            try:
                return loop.run_until_complete(task)
            except asyncio.CancelledError:
                if self._interrupts and uncancel(task) == 0:
                    raise KeyboardInterrupt from None
                raise

    def close(self) -> None:
        """Cancel what runs still, wait for it, and close the loop."""
        loop, self._loop = self._loop, None
        if loop is None:
            return
        try:
            _cancel_all(loop)
            loop.run_until_complete(loop.shutdown_asyncgens())
            loop.run_until_complete(loop.shutdown_default_executor())
        finally:
            asyncio.set_event_loop(None)
            loop.close()

    @contextlib.contextmanager
    def _signals(self, task: asyncio.Task[Any]) -> Any:
        """Make Ctrl-C cancel the task first, unless another handler is set for the signal."""
        mine = threading.current_thread() is threading.main_thread()
        if not mine or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            yield
            return

        def interrupted(_number: int, _frame: FrameType | None) -> None:
            self._interrupts += 1
            if self._interrupts > 1 or task.done():
                raise KeyboardInterrupt
            task.cancel()
            self.get_loop().call_soon_threadsafe(lambda: None)  # a loop that sleeps wakes up

        signal.signal(signal.SIGINT, interrupted)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, signal.default_int_handler)


def _cancel_all(loop: asyncio.AbstractEventLoop) -> None:
    tasks = asyncio.all_tasks(loop)
    for task in tasks:
        task.cancel()
    if tasks:
        loop.run_until_complete(asyncio.wait(tasks))
    for task in tasks:
        if not task.cancelled() and (error := task.exception()) is not None:
            loop.call_exception_handler({"message": f"{task.get_name()} failed", "exception": error, "task": task})
