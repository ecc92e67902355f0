"""Joins an action on two graphs: its provider on the source carries out the goals that arrive on the target."""

from __future__ import annotations

import asyncio
import contextlib
import logging

from ropeway.bridge.offer import Offer
from ropeway.bridge.options import AS_IT_COMES, BridgeOptions
from ropeway.errors import CallTimeout, GoalRejected, GraphError
from ropeway.graph.base import Graph
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


class ActionBridge(Offer):
    """Offers an action of ``source`` on ``target``: exposed if that is the far side, reserved if it is ours.

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
        options: BridgeOptions = AS_IT_COMES,
    ) -> None:
        super().__init__(source, target, source_name, target_name, type, options)
        self._goals: dict[bytes, ClientGoal] = {}

    async def make_client(self) -> ActionClient:
        """Create the client of the action on the source."""
        return await self.source.create_action_client(self.source_name, self.type, delivery=self.delivery)

    async def make_server(self) -> ActionServer:
        """Create the server of the action on the target."""
        handlers = ActionHandlers(self._execute, self._accept, self._cancel)
        return await self.target.create_action_server(self.target_name, self.type, handlers, delivery=self.delivery)

    async def _accept(self, goal: ServerGoal) -> bool:
        if goal.id in self._goals:
            return False
        if self.witness is not None:
            self.witness(goal.payload, goal.caller)
        try:
            self._goals[goal.id] = await self._client.send_goal(
                Goal(goal.payload, goal.id, goal.via, goal.caller),
                on_feedback=lambda feedback: goal.feedback(feedback),
                timeout_s=DEFAULT_TIMEOUT_S,
            )
        except GraphError as error:
            self.counts[type(error).__name__] += 1
            if not isinstance(error, GoalRejected):
                log.warning("a goal of %s was rejected: %s", self.target_name, error)
            return False
        return True

    async def _execute(self, goal: ServerGoal) -> Outcome:
        clock = asyncio.get_running_loop().time
        began, how = clock(), "given up"
        running = self._goals[goal.id]
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
        running = self._goals.get(goal.id)
        return running is not None and await running.cancel()

    async def withdrawn(self) -> None:
        """Abort goals that were accepted and not begun."""
        for running in list(self._goals.values()):
            await self._give_up(running)

    async def _give_up(self, running: ClientGoal) -> None:
        with contextlib.suppress(GraphError):
            await running.cancel()
