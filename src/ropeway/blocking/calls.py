"""Clients, services and actions for threads."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TypeVar

from ropeway.api.actions import (
    AsyncActionClient,
    AsyncActionServer,
    AsyncGoal,
    ExecuteGoal,
    ExecutingGoal,
    GoalResult,
)
from ropeway.api.message import TypedMessage
from ropeway.api.services import AsyncClient, AsyncService
from ropeway.blocking.part import BlockingPart
from ropeway.blocking.portal import portal
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Outcome

__all__ = [
    "BlockingActionClient",
    "BlockingActionServer",
    "BlockingClient",
    "BlockingExecutingGoal",
    "BlockingGoal",
    "BlockingService",
    "executed_in_thread",
]


_User = TypeVar("_User", bound=AsyncClient | AsyncActionClient)
_Server = TypeVar("_Server", bound=AsyncService | AsyncActionServer)


class _UserPart(BlockingPart[_User]):
    """A service or an action that a program uses."""

    @property
    def type(self) -> str:
        """Return the full name of its type."""
        return self._inner.type

    @property
    def available(self) -> bool | None:
        """Return whether somebody serves it now, ``None`` where the network cannot tell before it is used."""
        return self._inner.available

    def wait_available(self, *, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        """Wait until somebody serves it. Raises ``NotServed``."""
        portal.run(lambda: self._inner.wait_available(timeout_s=timeout_s), None)


class _OfferPart(BlockingPart[_Server]):
    """A service or an action that a program offers."""

    @property
    def type(self) -> str:
        """Return the full name of its type."""
        return self._inner.type

    @property
    def taken_by(self) -> str:
        """Return who else serves the name, until which leaves this one waits; ``""`` while it serves."""
        return self._inner.taken_by


class BlockingClient(_UserPart[AsyncClient]):
    """A service that a program calls; ``BlockingGraph.client`` makes it. Threads may call at the same time."""

    @property
    def service(self) -> str:
        """Return the name of the service."""
        return self._inner.service

    def call(self, request: object = None, *, timeout_s: float = DEFAULT_TIMEOUT_S) -> TypedMessage:
        """Return the response to ``request``; see ``AsyncClient.call``."""
        return portal.run(lambda: self._inner.call(request, timeout_s=timeout_s), None)


class BlockingService(_OfferPart[AsyncService]):
    """A service that a program offers; ``BlockingGraph.serve`` makes it. Calls run in threads, at the same time."""

    @property
    def service(self) -> str:
        """Return its name."""
        return self._inner.service


class BlockingGoal:
    """A goal that an action server has accepted; ``BlockingActionClient.send_goal`` gives it."""

    def __init__(self, inner: AsyncGoal) -> None:
        self.id = inner.id
        self._inner = inner

    def result(self, *, timeout_s: float | None = None) -> GoalResult:
        """Wait for the end of the goal. Raises ``CallTimeout``; the goal then goes on."""
        return portal.run(lambda: self._inner.result(timeout_s=timeout_s), None)

    def cancel(self, *, timeout_s: float = DEFAULT_TIMEOUT_S) -> bool:
        """Ask for the end of the goal; return whether the server agrees."""
        return portal.run(lambda: self._inner.cancel(timeout_s=timeout_s), None)


class BlockingActionClient(_UserPart[AsyncActionClient]):
    """An action that a program uses; ``BlockingGraph.action_client`` makes it."""

    @property
    def action(self) -> str:
        """Return the name of the action."""
        return self._inner.action

    def send_goal(
        self,
        goal: object = None,
        *,
        on_feedback: Callable[[TypedMessage], None] | None = None,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> BlockingGoal:
        """Send a goal and wait until it is accepted; see ``AsyncActionClient.send_goal``.

        ``on_feedback`` is called in a thread, with one feedback after the other.
        """
        take = None if on_feedback is None else portal.in_thread(on_feedback)
        return BlockingGoal(
            portal.run(lambda: self._inner.send_goal(goal, on_feedback=take, timeout_s=timeout_s), None)
        )


class BlockingExecutingGoal:
    """A goal that a program carries out in a thread: an action server's function gets it and returns how it ended."""

    def __init__(self, inner: ExecutingGoal) -> None:
        self.id, self.request = inner.id, inner.request
        self._inner = inner
        self._abandoned = False

    @property
    def cancel_requested(self) -> bool:
        """Return whether somebody asked for the end of the goal, or nobody is there any more who waits for it."""
        return self._abandoned or self._inner.cancel_requested

    def abandon(self) -> None:
        """Set ``cancel_requested``: nobody waits for the goal any more."""
        self._abandoned = True

    def feedback(self, message: object) -> None:
        """Send feedback; see ``ExecutingGoal.feedback``."""
        portal.call(lambda: self._inner.feedback(message))

    def succeed(self, result: object = None) -> Outcome:
        """Return the outcome of a goal that was reached; returning ``result`` itself means the same."""
        return self._inner.succeed(result)

    def canceled(self, result: object = None) -> Outcome:
        """Return the outcome of a goal that was given up because somebody asked for that."""
        return self._inner.canceled(result)

    def abort(self, text: str = "", result: object = None) -> Outcome:
        """Return the outcome of a goal that cannot be reached; ``text`` says why. Raising an error means the same."""
        return self._inner.abort(text, result)


def executed_in_thread(execute: Callable[[BlockingExecutingGoal], object]) -> ExecuteGoal:
    """Return a coroutine function that carries goals out by ``execute``, each in a thread."""
    run = portal.in_thread(execute)

    async def carry_out(inner: ExecutingGoal) -> object:
        goal = BlockingExecutingGoal(inner)
        try:
            return await run(goal)
        except asyncio.CancelledError:
            goal.abandon()
            raise

    return carry_out


class BlockingActionServer(_OfferPart[AsyncActionServer]):
    """An action that a program offers; ``BlockingGraph.serve_action`` makes it. Goals are carried out in threads."""

    @property
    def action(self) -> str:
        """Return its name."""
        return self._inner.action
