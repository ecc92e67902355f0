"""The calls of rosapi that one client has made and that are not answered yet.

An answer of rosapi is often a hundred times as long as its request. So calls are answered in order, the next one once
the client has read nearly everything that waits for it; until then only the request is kept.
"""

from __future__ import annotations

import asyncio
import inspect
from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from ropeway.networks.rosbridge.protocol import ops
from ropeway.tasks import Chores

if TYPE_CHECKING:
    from ropeway.listener.turns import Turns
    from ropeway.networks.rosbridge.link.peer import Peer

__all__ = ["RosapiCalls"]

_ASKING: Final = 16  # calls that wait for other nodes: their parameters

Question = Callable[[], Any]
"""Finds the ``values`` of an answer; a coroutine function where other nodes have to be asked."""


class RosapiCalls:
    """Answers one client's calls of rosapi. ``fail`` answers a call that failed."""

    def __init__(self, peer: Peer, turns: Turns[Any], fail: Callable[[ops.CallService, Exception], None]) -> None:
        self._peer, self._turns, self._fail = peer, turns, fail
        self._waiting: deque[tuple[ops.CallService, Question]] = deque()
        self._asking: dict[asyncio.Task[None], ops.CallService] = {}
        self._free = asyncio.Semaphore(_ASKING)
        self._tasks = Chores()
        self._working = False

    def add(self, op: ops.CallService, question: Question) -> None:
        """Answer a call when it has its turn."""
        op.args = None  # the question has what is needed of it
        self._waiting.append((op, question))
        self._turns.questions += 1
        if not self._working:
            self._working = True
            self._tasks.start(self._work(), "answers of rosapi")

    async def close(self) -> list[ops.CallService]:
        """Stop answering; return the calls that were not answered."""
        left = [*self._asking.values(), *(op for op, _ in self._waiting)]
        self._turns.questions -= len(self._waiting)
        self._waiting.clear()
        await self._tasks.close()
        return left

    async def _work(self) -> None:
        while self._waiting:
            await self._peer.room_for_answers()
            if self._waiting:  # else all were given up meanwhile
                self._turns.questions -= 1
                self._begin(*self._waiting.popleft())
                self._turns.ease()
            await asyncio.sleep(0)  # others have their turn, however much this client asks for
        self._working = False

    def _begin(self, op: ops.CallService, question: Question) -> None:
        if inspect.iscoroutinefunction(question):
            task = self._tasks.start(self._ask(op, question), f"call of {op.service[:200]}")
            self._asking[task] = op
            self._turns.questions += 1
            task.add_done_callback(self._asked)
            return
        try:
            self._answer(op, question())
        except Exception as error:  # whatever it is, the client gets an answer
            self._fail(op, error)

    async def _ask(self, op: ops.CallService, question: Question) -> None:
        try:
            async with self._free:
                values = await question()
            self._answer(op, values)
        except Exception as error:  # whatever it is, the client gets an answer
            self._fail(op, error)

    def _asked(self, task: asyncio.Task[None]) -> None:
        self._asking.pop(task, None)
        self._turns.questions -= 1
        self._turns.ease()

    def _answer(self, op: ops.CallService, values: Mapping[str, Any]) -> None:
        reply = ops.ServiceResponse(service=op.service, values=values, result=True, id=op.id)
        self._peer.send_op(reply, fragment_size=op.fragment_size)
