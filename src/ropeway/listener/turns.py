"""Queues a client's operations until their turn, and decides whether its socket is read meanwhile.

A client's operations are kept until they are carried out, and its answers until it has read them. When either pile up,
its socket is not read: the operating system's window then holds the client back, and nobody else.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Final, Generic, Protocol, TypeVar

from ropeway.limits import UNREAD_S, WAITING_ANSWERS, WAITING_OPERATIONS, WAITING_OPERATIONS_BYTES

if TYPE_CHECKING:
    from ropeway.listener.connection import Connection

__all__ = ["Turns", "WaitingAnswers"]

Op = TypeVar("Op")

_RESUME_AT: Final = 32  # operations that still wait when the socket is read again


class WaitingAnswers(Protocol):
    """Holds the answers that wait until their client reads them."""

    @property
    def count(self) -> int:
        """The number of answers that wait."""
        ...

    on_gone: Callable[[], None] | None
    """Is called for each answer that has gone."""


class Turns(Generic[Op]):
    """Queues the operations of one client."""

    def __init__(self, connection: Connection, answers: WaitingAnswers) -> None:
        self.waiting: deque[Op] = deque()
        self.questions = 0
        """The number of requests beside the operations that are not answered."""
        self.paused = False
        self._connection, self._answers = connection, answers
        self._idle_bytes = 0  # what had been received before operations had to wait
        self._wake = asyncio.Event()
        self._moved_s = time.monotonic()  # when an answer went last
        self._answers.on_gone = self._answer_gone

    @property
    def bytes(self) -> int:
        """The number of bytes received while operations waited."""
        return self._connection.bytes_in - self._idle_bytes if self.waiting else 0

    def push(self, op: Op) -> None:
        """Let an operation wait for its turn."""
        if not self.waiting:
            self._idle_bytes = self._connection.bytes_in
        self.waiting.append(op)
        self._wake.set()

    def wake(self) -> None:
        """Make ``wait`` return, even if nothing waits."""
        self._wake.set()

    async def wait(self) -> None:
        """Wait until there may be something to do."""
        await self._wake.wait()
        self._wake.clear()

    @property
    def ready(self) -> bool:
        """Whether an operation may run: none may while too many answers wait."""
        return bool(self.waiting) and self._answers.count <= WAITING_ANSWERS

    def forget(self) -> None:
        """Carry out nothing more of what waits: the client has left, maybe while an operation of it was carried out."""
        self.waiting.clear()

    async def carry_out(self, do: Callable[[Op], Awaitable[None]], over: Callable[[], bool]) -> None:
        """Carry out the operations with ``do``, one after the other, until it is ``over``."""
        while not over():
            await self.wait()
            while self.ready and not over():
                await do(self.waiting[0])
                if self.waiting:  # or the client has left meanwhile
                    self.waiting.popleft()
                self.ease()
                await asyncio.sleep(0)  # others have their turn, however much this client asks for

    def look(self) -> None:
        """Stop reading the client's socket if too much waits."""
        if not self.paused and (
            (self.waiting and (len(self.waiting) > WAITING_OPERATIONS or self._heavy))
            or self.questions > WAITING_OPERATIONS
            or self._answers.count > WAITING_ANSWERS
        ):
            self.paused = True
            self._connection.pause_reading()

    def ease(self) -> None:
        """Read the client's socket again, if there is room."""
        if (
            self.paused
            and len(self.waiting) <= (0 if self._heavy else _RESUME_AT)
            and self.questions <= _RESUME_AT
            and self._answers.count <= WAITING_ANSWERS // 2
        ):
            self.paused = False
            self._connection.resume_reading()

    def tick(self) -> None:
        """Close a client that takes none of many answers; called about once a second."""
        if self.paused and self._answers.count > WAITING_ANSWERS // 2:
            if time.monotonic() - self._moved_s > UNREAD_S:
                self._connection.close(1008, "answers are not read")
        else:
            self._moved_s = time.monotonic()

    def _answer_gone(self) -> None:
        if self.paused:
            self._moved_s = time.monotonic()
            if self.ready:
                self._wake.set()
            self.ease()

    @property
    def _heavy(self) -> bool:
        return self.bytes > WAITING_OPERATIONS_BYTES
