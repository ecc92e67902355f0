"""Calls that begin in the callback that brought them and end in the one that brings the answer: without a task.

A task costs a turn of the event loop before it begins, and another before it goes on. A client that can do without has
``begin``, and so has a handler that passes requests on to such a client. What cannot be done at once (nobody serves it,
too much is under way, something has to be looked up) is left to ``call``, which waits.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Protocol, TypeVar, runtime_checkable

from ropeway.graph.calls import Request, ServiceHandler

__all__ = ["BeginningClient", "BeginningHandler", "Begins", "Begun", "Ended", "Handler", "into"]

T = TypeVar("T")

Ended = Callable[[bytes | BaseException], None]
"""Takes what came of a call: the response, or why there is none; ``CancelledError`` where nobody waits any more."""


class Begun:
    """A call under way. It ends once, with whatever comes first."""

    __slots__ = ("_ended", "expiry")

    def __init__(self, ended: Ended) -> None:
        self._ended: Ended | None = ended
        self.expiry: asyncio.TimerHandle | None = None

    @property
    def over(self) -> bool:
        """Whether it has ended."""
        return self._ended is None

    def end(self, how: bytes | BaseException) -> None:
        """End the call, if it has not ended yet."""
        ended, self._ended = self._ended, None
        if ended is None:
            return
        if self.expiry is not None:
            self.expiry.cancel()
        ended(how)

    def give_up(self) -> None:
        """End it because nobody waits any more."""
        self.end(asyncio.CancelledError())

    def expire(self) -> None:
        """End it because its time is over."""
        self.end(TimeoutError())


Begins = Callable[[Request, float, Ended], Begun | None]
"""The ``begin`` of a client."""


@runtime_checkable
class BeginningClient(Protocol):
    """A client that can begin a call at once."""

    def begin(self, request: Request, timeout_s: float, ended: Ended) -> Begun | None:
        """Begin a call, or return ``None`` where it would have to wait: then nothing has happened yet.

        ``ended`` is called once, and not before this returns.
        """


@runtime_checkable
class BeginningHandler(Protocol):
    """A handler of a service that can begin to answer at once."""

    def __call__(self, request: Request) -> Awaitable[bytes]:
        """Answer a request; see ``ServiceHandler``."""

    def begin(self, request: Request, ended: Ended) -> Begun | None:
        """Begin to answer a request; see ``BeginningClient.begin``."""


class Handler:
    """A ``BeginningHandler`` made of two functions."""

    def __init__(self, answer: ServiceHandler, begin: Callable[[Request, Ended], Begun | None]) -> None:
        self._answer, self.begin = answer, begin

    def __call__(self, request: Request) -> Awaitable[bytes]:
        """Answer a request; see ``ServiceHandler``."""
        return self._answer(request)


def into(future: asyncio.Future[T]) -> Callable[[T | BaseException], None]:
    """Return what has a future end as a call does."""

    def ended(how: T | BaseException) -> None:
        if future.done():
            return
        if isinstance(how, asyncio.CancelledError):
            future.cancel()
        elif isinstance(how, BaseException):
            future.set_exception(how)
        else:
            future.set_result(how)

    return ended
