"""Shares the actions of one graph between its users: a provider serves the network and all views."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Final, Protocol

from ropeway.errors import CallError, CallFailed, CallTimeout, GoalRejected, GraphUnavailable, NotServed
from ropeway.graph.base import Delivery
from ropeway.graph.calls import (
    DEFAULT_TIMEOUT_S,
    ActionClient,
    ActionHandlers,
    ActionServer,
    ClientGoal,
    Goal,
    GoalStatus,
    Outcome,
)
from ropeway.graph.local_calls import DirectGoal
from ropeway.hub.calls import NOBODY_S, SharedClients, either
from ropeway.hub.ownership import Claim, Claimant, NameOwners
from ropeway.logs import failed
from ropeway.tasks import background, describe, end, settled

__all__ = ["ViewActionClient", "ViewActionServer"]

log = logging.getLogger("ropeway.hub")

_GOALS: Final = 4096


class SharedActions(SharedClients, Protocol):
    """Holds what the users of one graph share of its actions."""

    actions: NameOwners[ViewActionServer]


class ViewActionServer(Claimant):
    """An action that a view offers."""

    def __init__(
        self, calls: SharedActions, user: str, action: str, type: str, handlers: ActionHandlers, delivery: Delivery
    ) -> None:
        self.action, self.type, self.handlers = action, type, handlers
        self._calls, self._delivery = calls, delivery
        self._goals: dict[bytes, DirectGoal] = {}
        super().__init__(Claim(action, user, self, self._create))

    async def _create(self) -> ActionServer:
        return await self._calls.graph.create_action_server(
            self.action, self.type, self.handlers, delivery=self._delivery
        )

    async def start(self, goal: Goal, on_feedback: Callable[[bytes], None], timeout_s: float) -> DirectGoal:
        """Begin a goal from inside this process."""
        if goal.id in self._goals:
            raise GoalRejected(self.action)
        if len(self._goals) >= _GOALS:
            raise CallFailed(self.action, f"{self.action} has {_GOALS} goals under way")
        running = self._goals[goal.id] = DirectGoal(self.action, self.handlers, goal, on_feedback)
        try:
            await running.start(timeout_s)
        except BaseException:
            self._goals.pop(goal.id, None)
            raise
        running.on_done(lambda: self._forget(goal.id))
        return running

    def _forget(self, id: bytes) -> None:
        self._goals.pop(id, None)

    async def close(self) -> None:
        """Stop serving: goals under way are aborted."""
        if self.closed:
            return
        for goal in list(self._goals.values()):
            await goal.abort()
        await self._calls.actions.remove(self.entry)
        for goal in list(self._goals.values()):  # those that began meanwhile
            await goal.abort()
        self._tell_closed()


class ViewActionClient:
    """An action that a view uses: at the view that serves it, or on the graph."""

    def __init__(self, calls: SharedActions, action: str, type: str) -> None:
        self.action, self.type = action, type
        self.closed = False
        self._calls = calls
        self._inner: ActionClient | None = None
        self._goals: set[_ViewGoal] = set()

    async def attach(self, delivery: Delivery) -> None:
        """Get the client of the graph."""
        self._inner = await self._calls.acquire("action", self.action, self.type, delivery)

    def _provider(self) -> ViewActionServer | None:
        entry = self._calls.actions.holder(self.action)
        return entry.provider if entry is not None else None

    @property
    def available(self) -> bool | None:
        """Whether a view or a provider on the network serves it."""
        if self._provider() is not None:
            return True
        return self._inner.available if self._inner is not None else False

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``ActionClient``."""
        assert self._inner is not None
        return await either(
            self._inner.wait_available(timeout_s), lambda: self._provider() is not None, self._calls.actions, timeout_s
        )

    async def find(self, timeout_s: float) -> None:
        """Wait a moment for who serves it. Raises ``NotServed``."""
        if self.available is False and not await self.wait_available(min(NOBODY_S, timeout_s)):
            raise NotServed(self.action, "action")

    async def send_goal(
        self,
        goal: Goal,
        *,
        on_feedback: Callable[[bytes], None] | None = None,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> ClientGoal:
        """See ``ActionClient``."""
        if self.closed or self._inner is None:
            raise GraphUnavailable(self._calls.graph.name, f"the client of {self.action} is closed")
        self._calls.check_circle(self.action, goal.via)
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        await self.find(timeout_s)
        left = max(deadline - loop.time(), 0.001)
        provider = self._provider()
        if provider is not None:
            if provider.type != self.type:
                raise CallFailed(self.action, f"{self.action} is of type {provider.type}, not {self.type}")
            inner: ClientGoal = await provider.start(goal, on_feedback or _nobody, left)
        else:
            inner = await self._inner.send_goal(goal, on_feedback=on_feedback, timeout_s=left)
        view_goal = _ViewGoal(self.action, inner)
        self._goals.add(view_goal)
        view_goal.ended.add_done_callback(lambda _: self._goals.discard(view_goal))
        return view_goal

    async def close(self) -> None:
        """Forget the action; outcomes still awaited are ABORTED."""
        if self.closed:
            return
        self.closed = True
        for goal in list(self._goals):
            await goal.forget()
        if self._inner is not None:
            self._inner = None
            await self._calls.release("action", self.action, self.type)


class _ViewGoal:
    """A goal of a view; it ends with the goal, or when the view forgets it."""

    def __init__(self, action: str, inner: ClientGoal) -> None:
        self.id = inner.id
        self._action, self._inner = action, inner
        self.ended: asyncio.Future[Outcome] = asyncio.get_running_loop().create_future()
        self._follow = background(self._wait(), f"outcome of {action}")

    async def _wait(self) -> None:
        try:
            outcome = await self._inner.result()
        except CallError as error:
            outcome = aborted(str(error))
        except Exception as error:  # of a graph: nobody shall wait for an outcome that does not come
            failed(log, "a goal of %s has no outcome", self._action)
            outcome = aborted(describe(error))
        if not self.ended.done():
            self.ended.set_result(outcome)

    async def result(self, timeout_s: float | None = None) -> Outcome:
        if not await settled(self.ended, timeout_s):
            assert timeout_s is not None
            raise CallTimeout(self._action, timeout_s, "action")
        return self.ended.result()

    async def cancel(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> bool:
        return False if self.ended.done() else await self._inner.cancel(timeout_s)

    async def forget(self) -> None:
        if not self.ended.done():
            self.ended.set_result(aborted("the client was closed"))
        await end(self._follow)


def aborted(text: str) -> Outcome:
    return Outcome(GoalStatus.ABORTED, None, text)


def _nobody(payload: bytes) -> None:
    """Ignore feedback that nobody asked for."""
