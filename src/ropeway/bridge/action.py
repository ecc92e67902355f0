"""Joins one action on two graphs: goals that come on the target are carried out by who serves it on the source."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import Callable
from typing import Final

from ropeway.bridge.offer import Offer
from ropeway.errors import CallError, CallTimeout, GoalRejected
from ropeway.graph.base import NO_HINTS, Delivery, Graph
from ropeway.graph.calls import (
    DEFAULT_TIMEOUT_S,
    ActionClient,
    ActionHandlers,
    ActionServer,
    ClientGoal,
    Goal,
    GoalStatus,
    Outcome,
    ServerGoal,
)

__all__ = ["ActionBridge"]

log = logging.getLogger("ropeway.bridge")


_EARLY: Final = 256  # feedback that waits until its goal has begun; the oldest goes first


class _News:
    """Feedback of a goal: what comes before the goal has begun on the other side waits for that."""

    def __init__(self) -> None:
        self._give: Callable[[bytes], None] | None = None
        self._early: deque[bytes] = deque(maxlen=_EARLY)

    def put(self, payload: bytes) -> None:
        """Pass feedback on."""
        if self._give is None:
            self._early.append(payload)
        else:
            self._give(payload)

    def flow(self, give: Callable[[bytes], None]) -> None:
        """The goal has begun; ``give`` takes its feedback."""
        self._give = give
        while self._early:
            give(self._early.popleft())


class ActionBridge(Offer):
    """One action of ``source`` offered on ``target``: exposed if that is the far side, reserved if it is ours.

    A goal that takes longer than ``timeout_s`` is cancelled and aborted; ``None`` lets it take its time.
    """

    kind = "action"

    def __init__(
        self,
        source: Graph,
        target: Graph,
        source_name: str,
        target_name: str,
        type: str,
        *,
        timeout_s: float | None = None,
        delivery: Delivery = NO_HINTS,
    ) -> None:
        super().__init__(source, target, source_name, target_name, type, timeout_s=timeout_s, delivery=delivery)
        self._goals: dict[bytes, tuple[ClientGoal, _News]] = {}

    async def make_client(self) -> ActionClient:
        """The action on the source."""
        return await self.source.create_action_client(self.source_name, self.type, delivery=self.delivery)

    async def make_server(self) -> ActionServer:
        """The action on the target."""
        handlers = ActionHandlers(self._execute, self._accept, self._cancel)
        return await self.target.create_action_server(self.target_name, self.type, handlers, delivery=self.delivery)

    async def _accept(self, goal: ServerGoal) -> bool:
        if goal.id in self._goals:
            return False
        news = _News()
        try:
            running = await self._client.send_goal(
                Goal(goal.payload, goal.id, goal.via, goal.caller), on_feedback=news.put, timeout_s=DEFAULT_TIMEOUT_S
            )
        except CallError as error:
            self.counts[type(error).__name__] += 1
            if not isinstance(error, GoalRejected):
                log.warning("a goal of %s was rejected: %s", self.target_name, error)
            return False
        self._goals[goal.id] = (running, news)
        return True

    async def _execute(self, goal: ServerGoal) -> Outcome:
        clock = asyncio.get_running_loop().time
        began, how = clock(), "given up"
        running, news = self._goals[goal.id]
        news.flow(goal.feedback)
        self.under_way += 1
        try:
            outcome = await running.result(self.timeout_s)
            how = outcome.status.name.lower()
        except CallTimeout as error:
            how = "timed out"
            await self._give_up(running)
            outcome = Outcome(GoalStatus.ABORTED, None, str(error))
        except asyncio.CancelledError:  # nobody is left who wants it
            await self._give_up(running)
            raise
        finally:
            self.under_way -= 1
            self._goals.pop(goal.id, None)
            self.done(how, clock() - began)
        return outcome

    async def _cancel(self, goal: ServerGoal) -> bool:
        running, _ = self._goals.get(goal.id, (None, None))
        return running is not None and await running.cancel()

    async def withdrawn(self) -> None:
        """Goals that were accepted and not begun."""
        for running, _ in list(self._goals.values()):
            await self._give_up(running)

    async def _give_up(self, running: ClientGoal) -> None:
        with contextlib.suppress(CallError):
            await running.cancel()
