"""Asks several members of a group the same, one of them in the task of the caller: the first answer wins.

A task costs more than a request, so only members beside the first have one, and only once they are asked.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterable, Sequence
from typing import Any, Final, Generic, TypeVar

from ropeway.errors import CallError, CallFailed, CallTimeout, GraphUnavailable, NotServed, RopewayError
from ropeway.tasks import Interruptible, end

__all__ = ["UNTOUCHED", "Race"]

T = TypeVar("T")

UNTOUCHED: Final = (NotServed, GraphUnavailable)
"""After these errors nobody has begun to carry it out."""

MayGoOn = Callable[[RopewayError], bool]
"""Says whether another member may be asked after one has failed so."""


class _Beaten(Exception):
    """Ends the wait for the first member: another has answered."""


class Race(Generic[T]):
    """A request to several members. ``ask`` asks one of them; ``waiting`` gives more of them, each when it is due.

    A failure counts only when nobody else can answer; ``errors`` has those of members that were asked before.
    """

    def __init__(
        self,
        ask: Callable[[str], Coroutine[Any, Any, T]],
        waiting: Iterable[str],
        may_go_on: MayGoOn,
        errors: Iterable[RopewayError] = (),
    ) -> None:
        self._errors = list(errors)
        self._ask, self._waiting, self._may_go_on = ask, iter(waiting), may_go_on
        self._tasks: dict[asyncio.Task[T], None] = {}
        self._winner: asyncio.Task[T] | None = None
        self._first: Interruptible | None = None
        self._turn = asyncio.Event()

    async def run(self, first: Sequence[str], hedge_after_s: float | None = None) -> T:
        """Return the first answer: of ``first``, asked at once, or of one more, if none has come after a time.

        Raises the error of the one whose failure says most, if all fail.
        """
        loop = asyncio.get_running_loop()
        timer = None if hedge_after_s is None else loop.call_later(hedge_after_s, self._ask_next)
        for name in first[1:]:
            self._begin(name)
        name = first[0]
        try:
            while name:
                try:
                    with Interruptible() as self._first:
                        return await self._ask(name)
                except _Beaten:
                    pass
                except RopewayError as error:
                    self._errors.append(error)
                while self._winner is None and self._tasks:
                    self._turn.clear()
                    await self._turn.wait()
                if self._winner is not None:
                    return self._winner.result()
                name = next(self._waiting, "") if self._may_go_on(self._errors[-1]) else ""
            raise _telling(self._errors)
        finally:
            if timer is not None:
                timer.cancel()
            if losers := [task for task in self._tasks if not task.done()]:
                await end(*losers)

    def _ask_next(self) -> None:
        """Ask one more: no answer has come in the time in which one usually does."""
        name = next(self._waiting, "") if self._winner is None else ""
        if name:
            self._begin(name)

    def _begin(self, name: str) -> None:
        task = asyncio.create_task(self._ask(name))
        self._tasks[task] = None
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[T]) -> None:
        self._tasks.pop(task, None)
        if task.cancelled():
            return
        error = task.exception()
        if isinstance(error, RopewayError):
            self._errors.append(error)
        elif self._winner is None:  # an answer, or a fault of ours, which is not to be hidden
            self._winner = task
            if self._first is not None:
                self._first.interrupt(_Beaten())
        self._turn.set()


def _telling(errors: Iterable[RopewayError]) -> RopewayError:
    """Return the error that says most: what a provider said, what may have been begun, or that nobody is there."""
    ranks = (CallFailed, CallTimeout, CallError)

    def rank(error: RopewayError) -> int:
        if isinstance(error, UNTOUCHED):
            return len(ranks)
        return next((i for i, kind in enumerate(ranks) if isinstance(error, kind)), len(ranks) - 1)

    return min(errors, key=rank)
