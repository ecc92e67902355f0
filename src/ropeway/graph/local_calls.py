"""Runs calls and goals inside this process: a handler runs once for each caller, within a time limit."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Final

from ropeway import aio
from ropeway.errors import CallError, CallFailed, CallTimeout, GoalRejected, ProviderLost, RopewayError
from ropeway.graph.begun import Begun
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, ServerGoal
from ropeway.logs import failed
from ropeway.tasks import Interruptible, background, end, settled

__all__ = ["LEFT", "DirectGoal", "InFlight", "answer"]

log = logging.getLogger("ropeway.graph")

LEFT: Final = "who offered it has withdrawn it"


class _Block(Interruptible):
    """A call among those that are under way."""

    calls: InFlight

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        calls = self.calls
        calls.blocks.discard(self)
        if calls.closed:
            calls.ended.set()
        if self._error is None:
            self._task = None
        else:
            super().__exit__(kind)


class InFlight:
    """Calls under way, of a client or at a provider; ``fail`` ends them all, whoever waits for them."""

    def __init__(self) -> None:
        self.blocks: set[Interruptible] = set()
        self.begun: set[Begun] = set()
        self.ended = asyncio.Event()
        self.closed = False

    @property
    def busy(self) -> bool:
        """Whether a call is under way."""
        return bool(self.blocks or self.begun)

    def call(self) -> Interruptible:
        """Return a block in which a call runs."""
        block = _Block()
        block.calls = self
        self.blocks.add(block)
        return block

    async def fail(self, error: RopewayError) -> None:
        """End all calls with ``error``, and wait until they have ended."""
        self.closed = True
        for call in list(self.begun):
            call.end(error)
        for block in list(self.blocks):
            if not block.mine:
                block.interrupt(error)
        while any(not block.mine for block in self.blocks):
            self.ended.clear()
            await self.ended.wait()


async def answer(name: str, running: InFlight, work: Awaitable[bytes], timeout_s: float) -> bytes:
    """Run a handler within the time limit and return its answer.

    Raises ``CallTimeout``, ``ProviderLost``, the handler's own ``CallError``, or ``CallFailed`` with whatever else it
    raised.
    """
    limit = aio.timeout(timeout_s)
    try:
        async with limit:
            with running.call():
                return await work
    except CallError:
        await asyncio.sleep(0)  # who calls again at once must not keep the provider from leaving
        raise
    except Exception as error:  # a handler is somebody else's code; its failure is this call's
        if limit.expired():
            raise CallTimeout(name, timeout_s) from None
        if not isinstance(error, RopewayError):
            failed(log, "the handler of %s failed", name)
        raise CallFailed(name, str(error) or type(error).__name__) from error


class DirectGoal:
    """A goal that a handler in this process carries out; it is the caller's ``ClientGoal``."""

    def __init__(self, action: str, handlers: ActionHandlers, goal: Goal, on_feedback: Callable[[bytes], None]) -> None:
        self.id = goal.id
        self._action, self._handlers = action, handlers
        self._on_feedback = on_feedback
        self._goal = ServerGoal(goal.payload, goal.id, self._feedback, goal.via, goal.caller)
        self._work: asyncio.Task[Outcome] | None = None
        self._outcome: asyncio.Future[Outcome] = asyncio.get_running_loop().create_future()

    async def start(self, timeout_s: float) -> None:
        """Ask the provider to accept the goal, and begin it. Raises ``GoalRejected`` or ``CallTimeout``."""
        if self._handlers.accept is not None:
            try:
                async with aio.timeout(timeout_s):
                    accepted = await self._handlers.accept(self._goal)
            except TimeoutError:
                raise CallTimeout(self._action, timeout_s, "action") from None
            if not accepted:
                raise GoalRejected(self._action)
        if self._outcome.done():
            raise ProviderLost(self._action, LEFT)
        self._work = background(self._carry_out(), f"goal of {self._action}")

    async def _carry_out(self) -> Outcome:
        try:
            outcome = await self._handlers.execute(self._goal)
        except asyncio.CancelledError:
            self._finish(Outcome(GoalStatus.ABORTED, None, LEFT))
            raise
        except Exception as error:  # a handler is somebody else's code; its failure is the goal's
            if not isinstance(error, RopewayError):
                failed(log, "the handler of %s failed", self._action)
            outcome = Outcome(GoalStatus.ABORTED, None, str(error) or type(error).__name__)
        self._finish(outcome)
        return outcome

    def _feedback(self, payload: bytes) -> None:
        if not self._outcome.done():
            self._on_feedback(payload)

    def _finish(self, outcome: Outcome) -> None:
        if not self._outcome.done():
            self._outcome.set_result(outcome)

    @property
    def done(self) -> bool:
        """Whether the goal has ended."""
        return self._outcome.done()

    def on_done(self, callback: Callable[[], None]) -> None:
        """Call when it has ended."""
        self._outcome.add_done_callback(lambda _: callback())

    async def result(self, timeout_s: float | None = None) -> Outcome:
        """See ``ClientGoal``."""
        if not await settled(self._outcome, timeout_s):
            assert timeout_s is not None
            raise CallTimeout(self._action, timeout_s, "action")
        return self._outcome.result()

    async def cancel(self, timeout_s: float = 5.0) -> bool:
        """See ``ClientGoal``."""
        if self._outcome.done():
            return False
        if self._handlers.cancel is not None:
            try:
                async with aio.timeout(timeout_s):
                    if not await self._handlers.cancel(self._goal):
                        return False
            except TimeoutError:
                raise CallTimeout(self._action, timeout_s, "action") from None
        self._goal.cancelled.set()
        return True

    async def abort(self, text: str = LEFT) -> None:
        """Abort the goal because its provider has gone."""
        self._finish(Outcome(GoalStatus.ABORTED, None, text))
        await end(self._work)
