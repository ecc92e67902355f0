"""Calls a program's functions with messages: one that fails is logged and counted, and the next message is taken."""

from __future__ import annotations

import asyncio
import inspect
import logging
from collections.abc import Awaitable, Callable

from ropeway.api.inbox import Inbox
from ropeway.api.message import TypedMessage
from ropeway.logs import failed
from ropeway.tasks import Supervised

__all__ = ["Callbacks", "MessageCallback"]

log = logging.getLogger("ropeway.api")

MessageCallback = Callable[[TypedMessage], Awaitable[None] | None]
"""Is called with each message: a function, which must return soon, or a coroutine function."""


class Callbacks:
    """Calls ``callback`` with each message: a function at once, a coroutine function with one message at a time.

    Messages wait for a coroutine function in ``inbox``. ``on_failure`` is told when ``callback`` raises; ``label``
    names it in the log.
    """

    def __init__(
        self, callback: MessageCallback, inbox: Inbox, label: str, on_failure: Callable[[], None] = lambda: None
    ) -> None:
        self._callback, self._inbox, self._label, self._on_failure = callback, inbox, label, on_failure
        self._task: asyncio.Task[None] | None = None
        self._work: Supervised | None = None
        if _is_coroutine_function(callback):
            self._work = Supervised(self._run, f"callback for {label}").start()

    def put(self, message: TypedMessage) -> None:
        """Call with a message, now or when its turn comes."""
        if self._work is not None:
            self._inbox.put(message)
            return
        try:
            work = self._callback(message)
            if inspect.iscoroutine(work):
                work.close()
                raise TypeError("the callback returned a coroutine; give the coroutine function itself, not a lambda")
        except Exception:  # the function is the program's: the next message gets its chance
            self._failed()

    async def _run(self) -> None:
        self._task = asyncio.current_task()
        while (message := await self._inbox.get()) is not None:
            try:
                work = self._callback(message)
                assert work is not None
                await work
            except Exception:  # the function is the program's: the next message gets its chance
                self._failed()

    def _failed(self) -> None:
        failed(log, "the callback for %s failed", self._label)
        self._on_failure()

    async def finish(self) -> None:
        """Wait until what has come was taken."""
        self._inbox.finish()
        if self._work is not None:
            await self._work.wait()

    async def close(self) -> None:
        """Stop calling. A callback may close its own; it then runs to its end."""
        self._inbox.close()
        if self._work is not None and self._task is not asyncio.current_task():
            await self._work.close()


def _is_coroutine_function(callback: MessageCallback) -> bool:
    return inspect.iscoroutinefunction(callback) or inspect.iscoroutinefunction(type(callback).__call__)
