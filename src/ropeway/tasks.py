"""Ending tasks and blocks, right also when whoever ends them is being ended."""

from __future__ import annotations

import asyncio
from typing import Any

__all__ = ["Interruptible", "end"]


async def end(*tasks: asyncio.Task[Any] | None) -> None:
    """Cancel tasks and wait until they are done; a failure of theirs that nobody saw goes to the loop's handler.

    Awaiting a cancelled task with its ``CancelledError`` suppressed would swallow a cancellation of the caller, too.
    """
    ending = [task for task in tasks if task is not None]
    for task in ending:
        task.cancel()
    if ending:
        await asyncio.wait(ending)
    for task in ending:
        if not task.cancelled() and (error := task.exception()) is not None:
            context = {"message": f"{task.get_name()} failed", "exception": error, "task": task}
            asyncio.get_running_loop().call_exception_handler(context)


class Interruptible:
    """A block that others can end with an error of their choice, as ``asyncio.timeout`` ends one when time is over.

    Cheaper than a task of its own. ``interrupt`` may be called at any time; only the first counts, and only while the
    block runs. A cancellation of the task from elsewhere stays a cancellation.
    """

    __slots__ = ("_cancelling", "_error", "_task")

    def __init__(self) -> None:
        self._task: asyncio.Task[Any] | None = None
        self._error: Exception | None = None
        self._cancelling = 0

    @property
    def mine(self) -> bool:
        """True if it is the block that the caller runs in."""
        return self._task is not None and self._task is asyncio.current_task()

    def interrupt(self, error: Exception) -> None:
        """Have the block raise ``error`` where it waits."""
        if self._task is not None and self._error is None:
            self._error = error
            self._task.cancel()

    def __enter__(self) -> Interruptible:
        task = asyncio.current_task()
        assert task is not None
        self._task, self._cancelling = task, task.cancelling()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        task, self._task = self._task, None
        assert task is not None
        if self._error is None or task.uncancel() > self._cancelling:
            return
        if kind is None or issubclass(kind, asyncio.CancelledError):
            raise self._error from None
