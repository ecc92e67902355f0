"""Actions used over a link; ``servers`` has those that are served over it. They outlive connections."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING

from ropeway import aio
from ropeway.errors import (
    CallError,
    CallFailed,
    CallTimeout,
    GoalRejected,
    GraphUnavailable,
    LinkError,
    NotServed,
    ProviderLost,
    RopewayError,
    TypesError,
    WireError,
)
from ropeway.graph.base import Delivery, Undelivered
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Goal, GoalStatus, Outcome
from ropeway.graph.local_calls import InFlight
from ropeway.logs import failed
from ropeway.networks.rosbridge.client.call_notes import call_note, received
from ropeway.networks.rosbridge.client.calls import lane, travelling
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY
from ropeway.tasks import settled

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.client.calls import Calls
    from ropeway.networks.rosbridge.link.peer import Peer

__all__ = ["RemoteActionClient", "RemoteGoal"]

log = logging.getLogger("ropeway.rosbridge")


class RemoteGoal:
    """A goal that was sent; its users get it when it is accepted."""

    def __init__(
        self,
        client: RemoteActionClient,
        goal: Goal,
        on_feedback: Callable[[bytes], None] | None,
        *,
        peer: Peer,
        timeout_s: float,
    ) -> None:
        loop = asyncio.get_running_loop()
        self.id = goal.id
        self.wire_id = f"send_action_goal:{client.action}:{next(client.calls.numbers)}"
        self.accepted: asyncio.Future[None] = loop.create_future()
        self._client = client
        self._on_feedback = on_feedback
        self._outcome: asyncio.Future[Outcome] = loop.create_future()
        self._cancelling: asyncio.Future[bool] | None = None
        self._peer, self._timeout_s = peer, timeout_s

    @property
    def done(self) -> bool:
        """Whether the goal has ended."""
        return self._outcome.done()

    # ── what the peer says ─────────────────────────────────────────────────────────────────────────────────────

    def accept(self) -> None:
        """Note that the far side accepts the goal."""
        if not self.accepted.done():
            self.accepted.set_result(None)

    def refuse(self, error: RopewayError) -> None:
        """Reject the goal, or abort it if its provider cannot be reached any more."""
        if not self.accepted.done():
            self.accepted.set_exception(error)
        else:
            self.finish(Outcome(GoalStatus.ABORTED, None, str(error), isinstance(error, GoalRejected)))

    def fed(self, op: ops.ActionFeedback) -> None:
        """Deliver a feedback."""
        on_feedback, client = self._on_feedback, self._client
        if on_feedback is None or self.done:
            return
        peer = self._peer
        try:
            body = client.calls.bodies.of(f"{client.type}_Feedback")
            payload = body.read(op.values, op.compression, peer.limit_bytes)
        except (TypesError, WireError) as error:
            client.calls.graph.drops[client.action, Undelivered.DECODE] += 1
            peer.fault_log.note("feedback", client.action, error)
            return
        try:
            on_feedback(payload)
        except Exception:  # a callback is somebody else's code; the connection must not suffer
            client.calls.graph.drops[client.action, Undelivered.CALLBACK] += 1
            failed(log, "%s: a callback for feedback of %s failed", client.calls.graph.name, client.action)

    def ended(self, op: ops.ActionResult) -> None:
        """Take the result."""
        client = self._client
        status = GoalStatus(op.status) if op.status in (4, 5, 6) else GoalStatus.ABORTED
        if not op.result:
            error = received(client.action, op.values, op.ropeway, kind="action", timeout_s=self._timeout_s)
            if not self.accepted.done() and op.status not in (4, 5, 6):
                self.refuse(error)
                return
            self.accept()
            status = status if status is not GoalStatus.SUCCEEDED else GoalStatus.ABORTED
            text = op.values if isinstance(op.values, str) else str(error)
            self.finish(Outcome(status, None, text, isinstance(error, GoalRejected)))
            return
        self.accept()
        try:
            body = client.calls.bodies.of(f"{client.type}_Result")
            payload = body.read(op.values, op.compression, self._peer.limit_bytes)
        except (TypesError, WireError) as error:
            self.finish(Outcome(GoalStatus.ABORTED, None, f"the result cannot be read: {error}"))
        else:
            self.finish(Outcome(status, payload))

    def cancel_answered(self, agreed: bool) -> None:
        """Note whether the far side accepts the cancellation."""
        if self._cancelling is not None and not self._cancelling.done():
            self._cancelling.set_result(agreed)

    def lost(self, reason: str) -> None:
        """Fail or abort the goal: the link has gone."""
        if self.accepted.done():
            self.finish(Outcome(GoalStatus.ABORTED, None, reason))
        else:
            self.accepted.set_exception(ProviderLost(self._client.action, reason))
            self.accepted.exception()

    def finish(self, outcome: Outcome) -> None:
        """End the goal; only the first end counts."""
        if not self._outcome.done():
            self._outcome.set_result(outcome)
            self.cancel_answered(outcome.status is GoalStatus.CANCELED)
        self._client.calls.goals.pop(self.wire_id, None)

    # ── what its user asks for ─────────────────────────────────────────────────────────────────────────────────

    async def result(self, timeout_s: float | None = None) -> Outcome:
        """See ``ClientGoal``."""
        if not await settled(self._outcome, timeout_s):
            raise CallTimeout(self._client.action, timeout_s or 0.0, "action")
        return self._outcome.result()

    async def cancel(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> bool:
        """See ``ClientGoal``. A plain server does not say whether it agrees: true once it was asked."""
        dialect = self._peer.dialect
        if self.done or not dialect.cancels:
            return False
        self.ask_cancel()
        if dialect is not ROPEWAY:
            return True
        if self._cancelling is None or self._cancelling.done():
            self._cancelling = asyncio.get_running_loop().create_future()
        if not await settled(self._cancelling, timeout_s):
            raise CallTimeout(self._client.action, timeout_s, "action")
        return self._cancelling.result()

    def ask_cancel(self) -> None:
        """Ask for its end."""
        if self._peer.dialect.cancels:
            self._peer.send_op(ops.CancelActionGoal(id=self.wire_id, action=self._client.action))


class RemoteActionClient:
    """An action that we use on the far graph."""

    def __init__(self, calls: Calls, action: str, type: str, delivery: Delivery) -> None:
        self.action = self.name = action
        self.type, self.delivery = type, delivery
        self.calls = calls
        self.closed = False
        self._goals: set[RemoteGoal] = set()
        self._sending = InFlight()

    @property
    def available(self) -> bool | None:
        """Whether the far gateway shows a provider; false with the link down, ``None`` if the peer does not tell."""
        return False if self.closed else self.calls.available("action", self.action)

    @property
    def encoding(self) -> str:
        """The encoding of goals: a plain server has named none."""
        return travelling(self.delivery, self.calls.peer, None)

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``ActionClient``."""
        return await self.calls.wait_available(self, timeout_s)

    async def send_goal(
        self,
        goal: Goal,
        *,
        on_feedback: Callable[[bytes], None] | None = None,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> RemoteGoal:
        """See ``ActionClient``. With the link down it waits for it, then raises ``GraphUnavailable``.

        A plain server does not tell that it takes a goal: the goal is then given back as soon as it was sent.
        """
        if self.closed:
            raise GraphUnavailable(self.calls.graph.name, f"the client of {self.action} is closed")
        with self._sending.call():
            return await self._send(goal, on_feedback, timeout_s)

    async def _send(self, goal: Goal, on_feedback: Callable[[bytes], None] | None, timeout_s: float) -> RemoteGoal:
        began = asyncio.get_running_loop().time()
        deadline = began + timeout_s
        while True:
            peer = await self.calls.link(deadline)
            try:
                return await self._ask(peer, goal, on_feedback, deadline, timeout_s)
            except NotServed:
                if not await self.calls.may_try_again(self, began, deadline):
                    raise
            except TimeoutError:
                if self.available is False:
                    raise NotServed(self.action, "action") from None
                raise CallTimeout(self.action, timeout_s, "action") from None

    async def _ask(
        self,
        peer: Peer,
        goal: Goal,
        on_feedback: Callable[[bytes], None] | None,
        deadline: float,
        timeout_s: float,
    ) -> RemoteGoal:
        calls = self.calls
        made = RemoteGoal(self, goal, on_feedback, peer=peer, timeout_s=timeout_s)
        gateway = peer.dialect is ROPEWAY
        body = calls.bodies.of(f"{self.type}_Goal")
        calls.goals[made.wire_id] = made
        try:
            peer.send_op(
                ops.SendActionGoal(
                    id=made.wire_id,
                    action=self.action,
                    action_type=self.type,
                    args=None,
                    feedback=on_feedback is not None,
                    ropeway=call_note(goal, calls.graph.gateway_id, self.delivery.encoding) if gateway else None,
                ),
                payload=body.written(goal.payload),
                field="args",
                codec=body.codec,
                encoding=self.encoding,
                priority=lane(self.delivery),
                on_unsent=made.refuse,
            )
            if not gateway:
                made.accept()
            async with aio.timeout_at(deadline):
                await made.accepted
        except CallError:
            calls.goals.pop(made.wire_id, None)
            raise
        except (TypesError, WireError, LinkError) as error:
            calls.goals.pop(made.wire_id, None)
            raise CallFailed(self.action, str(error)) from error
        except (TimeoutError, asyncio.CancelledError):  # nobody would follow it
            calls.goals.pop(made.wire_id, None)
            made.ask_cancel()
            raise
        self._goals = {g for g in self._goals if not g.done}
        self._goals.add(made)
        return made

    async def close(self) -> None:
        """See ``ActionClient``. Goals under way go on where they are carried out."""
        if self.closed:
            return
        self.closed = True
        self.calls.clients.pop(self, None)
        text = f"the client of {self.action} was closed"
        await self._sending.fail(GraphUnavailable(self.calls.graph.name, text))
        for goal in self._goals:
            goal.finish(Outcome(GoalStatus.ABORTED, None, text))
        self._goals.clear()
