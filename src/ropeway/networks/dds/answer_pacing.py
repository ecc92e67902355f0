"""Answers at the speed of a node that keeps ten of them until it gets round to taking them."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Final

__all__ = ["AnswerPacing"]

_BURST: Final = 5
_STEP_S: Final = 0.002  # rclpy takes one in less, also on a busy machine


class AnswerPacing:
    """The answers to one client.

    A client that asks again once it has its answer never waits. One that asks much at a time gets its answers in a
    small burst, and then one every two milliseconds.
    """

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._open = 0
        self._tokens = float(_BURST)
        self._at = 0.0
        self._turns: deque[asyncio.Future[None]] = deque()
        self._timer: asyncio.TimerHandle | None = None

    def came(self) -> None:
        """Count a request that has arrived."""
        if not self._open:  # so the answers before it were taken
            self._tokens = min(_BURST, self._tokens + 1)
        self._open += 1

    def went(self) -> bool:
        """Count a request that is done with; return whether no other is under way."""
        self._open -= 1
        return not self._open

    @property
    def idle(self) -> bool:
        """Whether no request is under way."""
        return not self._open

    def may_go(self) -> bool:
        """Return whether an answer may go now, which it does then."""
        now = self._loop.time()
        self._tokens = min(_BURST, self._tokens + (now - self._at) / _STEP_S)
        self._at = now
        if self._tokens < 1 or self._turns:
            return False
        self._tokens -= 1
        return True

    async def turn(self) -> None:
        """Wait until an answer may go."""
        if self.may_go():
            return
        turn: asyncio.Future[None] = self._loop.create_future()
        self._turns.append(turn)
        if self._timer is None:
            self._timer = self._loop.call_later(_STEP_S, self._next)
        await turn

    def _next(self) -> None:
        self._timer = None
        now = self._loop.time()
        tokens = min(_BURST, self._tokens + (now - self._at) / _STEP_S)
        while self._turns and tokens >= 1:
            turn = self._turns.popleft()
            if not turn.done():
                turn.set_result(None)
                tokens -= 1
        self._tokens, self._at = tokens, now
        if self._turns:
            self._timer = self._loop.call_later(_STEP_S, self._next)
