"""Action clients and servers for programs."""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ropeway.api.callbacks import Callbacks, MessageCallback
from ropeway.api.calls import OfferPart, UserPart
from ropeway.api.inbox import QUEUE_BYTES, QUEUE_MESSAGES, Inbox
from ropeway.api.message import MessageType, TypedMessage
from ropeway.graph.calls import (
    DEFAULT_TIMEOUT_S,
    ActionHandlers,
    ClientGoal,
    Goal,
    GoalStatus,
    Outcome,
    ServerGoal,
)
from ropeway.hub.actions import ViewActionClient, ViewActionServer
from ropeway.tasks import Chores
from ropeway.types import TypeRegistry

if TYPE_CHECKING:
    from ropeway.hub.hub import View

__all__ = [
    "AcceptGoal",
    "ActionMessages",
    "AsyncActionClient",
    "AsyncActionServer",
    "AsyncGoal",
    "ExecuteGoal",
    "ExecutingGoal",
    "GoalResult",
    "action_messages",
]


@dataclass(frozen=True, slots=True)
class ActionMessages:
    """The types of what is sent for an action."""

    goal: MessageType
    result: MessageType
    feedback: MessageType


@dataclass(frozen=True, slots=True)
class GoalResult:
    """The end of a goal: ``status`` is SUCCEEDED, CANCELED or ABORTED, ``text`` says why, if that is known.

    ``result`` is ``None`` where the provider gave none, as when it left.
    """

    status: GoalStatus
    result: TypedMessage | None = None
    text: str = ""

    @property
    def succeeded(self) -> bool:
        """Return whether the goal was reached."""
        return self.status is GoalStatus.SUCCEEDED


class AsyncGoal:
    """A goal that an action server has accepted; ``AsyncActionClient.send_goal`` gives it."""

    def __init__(self, inner: ClientGoal, result: MessageType) -> None:
        self.id = inner.id
        self._inner, self._result = inner, result

    async def result(self, *, timeout_s: float | None = None) -> GoalResult:
        """Wait for the end of the goal; may be awaited again. Raises ``CallTimeout``; the goal then goes on."""
        outcome = await self._inner.result(timeout_s)
        message = None if outcome.payload is None else self._result.message(outcome.payload)
        return GoalResult(outcome.status, message, outcome.text)

    async def cancel(self, *, timeout_s: float = DEFAULT_TIMEOUT_S) -> bool:
        """Ask for the end of the goal; return whether the server agrees. ``result`` then tells how it ended.

        Raises ``CallError`` if nobody answers.
        """
        return await self._inner.cancel(timeout_s)


class AsyncActionClient(UserPart[ViewActionClient]):
    """An action that a program uses; ``AsyncGraph.action_client`` makes it."""

    def __init__(self, view: View, inner: ViewActionClient, messages: ActionMessages, caller: str) -> None:
        super().__init__(view, inner, "action", inner.action)
        self.action = inner.action
        self._messages, self._caller = messages, caller
        self._followers = Chores()

    async def send_goal(
        self,
        goal: object = None,
        *,
        on_feedback: MessageCallback | None = None,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> AsyncGoal:
        """Send a goal, in any form that ``AsyncPublisher.publish`` takes, and wait until it is accepted.

        ``on_feedback``, a function or a coroutine function, is called with each feedback. ``timeout_s`` bounds the wait
        for a server and its word. Raises ``ValueMismatch`` if the goal does not fit, ``GoalRejected``, ``NotServed``,
        ``CallTimeout``, ``ProviderLost``.
        """
        raw = self._messages.goal.encode(goal)
        left_s = await self._found(timeout_s)
        request = Goal(raw, caller=self._caller)
        if on_feedback is None:
            return AsyncGoal(await self._inner.send_goal(request, timeout_s=left_s), self._messages.result)
        inbox = Inbox(QUEUE_MESSAGES, QUEUE_BYTES)
        callbacks = Callbacks(on_feedback, inbox, f"feedback of {self.action}")

        def arrived(payload: bytes) -> None:
            callbacks.put(self._messages.feedback.message(payload))

        try:
            sent = await self._inner.send_goal(request, on_feedback=arrived, timeout_s=left_s)
        except BaseException:
            await callbacks.close()
            raise
        self._followers.start(_follow(sent, callbacks), f"feedback of {self.action}")
        return AsyncGoal(sent, self._messages.result)

    async def close(self) -> None:
        """Stop using the action; goals under way are reported as ABORTED."""
        await super().close()
        await self._followers.close()


async def _follow(goal: ClientGoal, callbacks: Callbacks) -> None:
    """Let the callbacks for feedback end with the goal."""
    try:
        await goal.result(None)
        await callbacks.finish()
    finally:
        await callbacks.close()


class ExecutingGoal:
    """A goal that a program carries out: an action server's function gets it and returns how it ended."""

    def __init__(self, inner: ServerGoal, messages: ActionMessages) -> None:
        self.id = inner.id
        self.request = messages.goal.message(inner.payload)
        self._inner, self._messages = inner, messages

    @property
    def cancel_requested(self) -> bool:
        """Return whether somebody asked for the end of the goal."""
        return self._inner.cancelled.is_set()

    async def wait_cancel_requested(self) -> None:
        """Wait until somebody asks for the end of the goal."""
        await self._inner.cancelled.wait()

    def feedback(self, message: object) -> None:
        """Send feedback, in any form that ``AsyncPublisher.publish`` takes. Raises ``ValueMismatch``."""
        self._inner.feedback(self._messages.feedback.encode(message))

    def succeed(self, result: object = None) -> Outcome:
        """Return the outcome of a goal that was reached; returning ``result`` itself means the same."""
        return Outcome(GoalStatus.SUCCEEDED, self._messages.result.encode(result))

    def canceled(self, result: object = None) -> Outcome:
        """Return the outcome of a goal that was given up because somebody asked for that."""
        return Outcome(GoalStatus.CANCELED, self._messages.result.encode(result))

    def abort(self, text: str = "", result: object = None) -> Outcome:
        """Return the outcome of a goal that cannot be reached; ``text`` says why. Raising an error means the same."""
        return Outcome(GoalStatus.ABORTED, self._messages.result.encode(result), text)


ExecuteGoal = Callable[[ExecutingGoal], Awaitable[object]]
"""Carries a goal out: returns an outcome that the goal made, or the result of a goal that was reached."""

AcceptGoal = Callable[[TypedMessage], bool | Awaitable[bool]]
"""Returns whether a goal is taken; may be a coroutine function."""


class AsyncActionServer(OfferPart[ViewActionServer]):
    """An action that a program offers; ``AsyncGraph.serve_action`` makes it.

    Goals are carried out at the same time; ``close`` aborts them.
    """

    def __init__(self, view: View, messages: ActionMessages, execute: ExecuteGoal, accept: AcceptGoal | None) -> None:
        super().__init__(view)
        self._messages = messages
        self._execute, self._accept = execute, accept

    def handlers(self) -> ActionHandlers:
        """Return what the graph calls for each goal."""
        return ActionHandlers(self._carry_out, None if self._accept is None else self._is_accepted)

    async def _carry_out(self, inner: ServerGoal) -> Outcome:
        goal = ExecutingGoal(inner, self._messages)
        ended = await self._execute(goal)
        return ended if isinstance(ended, Outcome) else goal.succeed(ended)

    async def _is_accepted(self, inner: ServerGoal) -> bool:
        assert self._accept is not None
        accepted = self._accept(self._messages.goal.message(inner.payload))
        return await accepted if inspect.isawaitable(accepted) else accepted

    @property
    def action(self) -> str:
        """Return its name."""
        return self._server.action


def action_messages(registry: TypeRegistry, type: str) -> ActionMessages:
    """Return the types of goals, results and feedback of an action. Raises ``UnknownType``."""
    return ActionMessages(*(MessageType(registry, f"{type}_{part}") for part in ("Goal", "Result", "Feedback")))
