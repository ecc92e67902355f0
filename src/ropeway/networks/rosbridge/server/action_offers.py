"""An action that a client serves, and the goals that it carries out."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from ropeway.errors import CallFailed, GoalRejected, InvalidOperation, ProviderLost, RopewayError, TypesError, WireError
from ropeway.graph.base import Delivery
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, ActionHandlers, Goal, GoalStatus, Outcome, ServerGoal
from ropeway.limits import GOALS_PER_OFFERED_ACTION
from ropeway.networks.rosbridge.client.call_notes import call_note, received
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.server.bodies import codec_of, decode_body, text_of
from ropeway.networks.rosbridge.server.service_offers import tell_state
from ropeway.tasks import end, settled

if TYPE_CHECKING:
    from ropeway.hub.actions import ViewActionServer
    from ropeway.networks.rosbridge.server.host import SessionHost

__all__ = ["OfferedAction", "TakenGoal"]


class OfferedAction:
    """An action that the client serves; ``action`` is its name as the client gave it, ``name`` that on the graph."""

    def __init__(self, session: SessionHost, op: ops.AdvertiseAction, name: str, type: str) -> None:
        self.session, self.action, self.name, self.type = session, op.action, name, type
        self.pending: dict[str, TakenGoal] = {}
        self.count = 0
        self.taken_by = ""
        self.closed = False
        self.given_type, self.compression = op.type, op.compression
        self._goals: dict[bytes, TakenGoal] = {}
        self._inner: ViewActionServer | None = None

    async def open(self) -> None:
        """Serve the action on the graph, or wait until its holder leaves. Raises what the graph raises."""
        handlers = ActionHandlers(self._execute, self._accept, self._cancel if self.session.gateway else None)
        delivery = Delivery(encoding=self.compression or "auto")
        self._inner = await self.session.view.create_action_server(self.name, self.type, handlers, delivery=delivery)
        self._inner.on_state(self._state)

    def _state(self, taken_by: str) -> None:
        tell_state(self.session, "action", self.action, self.taken_by, taken_by)
        self.taken_by = taken_by

    def restart(self, op: ops.AdvertiseAction) -> None:
        """Abort all goals: the client advertised the action once more."""
        self.abort_all("its provider began anew")
        self.given_type, self.compression = op.type, op.compression
        self.count = 0

    async def _accept(self, goal: ServerGoal) -> bool:
        """Accept a goal; a plain client takes every goal, and a gateway asks further on."""
        if self.closed or self.session.gone or len(self.pending) >= GOALS_PER_OFFERED_ACTION:
            return False
        if not self.session.gateway:
            return True
        taken = self._take(goal)
        try:
            return await taken.wait_accepted()
        finally:
            if not taken.is_accepted:
                self._forget(taken)

    async def _execute(self, goal: ServerGoal) -> Outcome:
        if self.closed:
            raise ProviderLost(self.name, "its provider has left")
        taken = self._goals.get(goal.id) or self._take(goal)
        taken.goal = goal
        try:
            return await taken.run()
        finally:
            self._forget(taken)

    async def _cancel(self, goal: ServerGoal) -> bool:
        taken = self._goals.get(goal.id)
        return await taken.ask_cancel() if taken is not None else False

    def _take(self, goal: ServerGoal) -> TakenGoal:
        self.count += 1
        taken = TakenGoal(self, f"action_goal:{self.action}:{self.count}", goal)
        self.pending[taken.id] = self._goals[goal.id] = taken
        taken.send()
        return taken

    def _forget(self, taken: TakenGoal) -> None:
        if self.pending.get(taken.id) is taken:
            del self.pending[taken.id]
        if self._goals.get(taken.goal.id) is taken:
            del self._goals[taken.goal.id]

    def abort_all(self, reason: str) -> None:
        """Abort all goals under way."""
        for goal in list(self.pending.values()):
            goal.end(Outcome(GoalStatus.ABORTED, None, f"{self.name} was not carried out: {reason}"))
        self.pending.clear()
        self._goals.clear()

    async def close(self, reason: str) -> None:
        """Stop carrying out goals; those under way are aborted."""
        self.closed = True
        self.abort_all(reason)
        await asyncio.sleep(0)  # who sent them is told why, before the graph says that nobody is there
        if self._inner is not None:
            await self._inner.close()


class TakenGoal:
    """A goal that the client carries out, under the ``id`` that it was given here."""

    def __init__(self, action: OfferedAction, id: str, goal: ServerGoal) -> None:
        self.id, self.goal = id, goal
        self.is_accepted = False
        self._action, self._session = action, action.session
        loop = asyncio.get_running_loop()
        self._outcome: asyncio.Future[Outcome] = loop.create_future()
        self._answer: asyncio.Future[bool] = loop.create_future()  # whether a gateway takes it
        self._agreed: asyncio.Future[bool] | None = None  # whether a gateway agrees to its end

    def send(self) -> None:
        """Send it to the client; one that cannot be sent is aborted."""
        action, session = self._action, self._session
        op = ops.SendActionGoal(
            id=self.id, action=action.action, action_type=action.given_type, args=None, feedback=True
        )
        if session.gateway:
            op.ropeway = call_note(
                Goal(self.goal.payload, self.goal.id, self.goal.via, self.goal.caller), session.gateway_id
            )
        try:
            session.peer.send_op(
                op,
                payload=self.goal.payload,
                field="args",
                codec=codec_of(session, action.type + "_Goal"),
                encoding=action.compression or "auto",
                on_unsent=self._unsent,
            )
        except RopewayError as error:
            self._unsent(error)

    def _unsent(self, error: RopewayError) -> None:
        self.end(Outcome(GoalStatus.ABORTED, None, str(error)))

    def accepted(self) -> None:
        """Note that the gateway accepts the goal."""
        self.is_accepted = True
        if not self._answer.done():
            self._answer.set_result(True)

    async def wait_accepted(self) -> bool:
        """Return whether the gateway accepts the goal; an abortion before that is no acceptance."""
        waited: set[asyncio.Future[Any]] = {self._answer, self._outcome}
        await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
        if self._answer.done():
            return self._answer.result()
        outcome = self._outcome.result()
        if outcome.text and not outcome.rejected:
            raise CallFailed(self._action.name, outcome.text)
        return False

    async def run(self) -> Outcome:
        """Wait for the end of the goal and return its outcome; a gateway is told by ``ask_cancel`` that it may end."""
        if self._session.gateway:
            await settled(self._outcome)
            return self._outcome.result()
        asked = asyncio.ensure_future(self.goal.cancelled.wait())
        try:
            waited: set[asyncio.Future[Any]] = {asked, self._outcome}
            await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
            if not self._outcome.done():
                self._session.peer.send_op(ops.CancelActionGoal(id=self.id, action=self._action.action))
            await settled(self._outcome)
        finally:
            await end(asked)
        return self._outcome.result()

    async def ask_cancel(self) -> bool:
        """Ask the gateway for its end."""
        agreed = self._agreed = asyncio.get_running_loop().create_future()
        self._session.peer.send_op(ops.CancelActionGoal(id=self.id, action=self._action.action))
        waited: set[asyncio.Future[Any]] = {agreed, self._outcome}
        await asyncio.wait(waited, timeout=DEFAULT_TIMEOUT_S, return_when=asyncio.FIRST_COMPLETED)
        return agreed.done() and bool(agreed.result())

    def cancelling(self, agreed: bool) -> None:
        """Note whether the gateway accepts the cancellation."""
        if self._agreed is not None and not self._agreed.done():
            self._agreed.set_result(agreed)

    def feedback(self, op: ops.ActionFeedback) -> None:
        """Pass on the client's feedback. Raises ``TypesError``."""
        if op.values is None:
            raise InvalidOperation("", "Expected a values field but none was found.")
        self.goal.feedback(decode_body(self._session, op.values, op.compression, self._action.type + "_Feedback"))

    def ended(self, op: ops.ActionResult) -> None:
        """Take the client's result. Raises ``TypesError``, and the goal is aborted."""
        name = self._action.name
        if not op.result or isinstance(op.values, str):
            status = GoalStatus.CANCELED if op.result and op.status == GoalStatus.CANCELED else GoalStatus.ABORTED
            if self._session.gateway and op.status in (GoalStatus.SUCCEEDED, GoalStatus.CANCELED):
                status = GoalStatus(op.status)
            error = received(name, op.values, op.ropeway, kind="action", timeout_s=0.0) if op.values else None
            self.end(Outcome(status, None, str(error or ""), isinstance(error, GoalRejected)))
            return
        try:
            payload = decode_body(self._session, op.values, op.compression, self._action.type + "_Result")
        except (TypesError, WireError) as error:
            self.end(Outcome(GoalStatus.ABORTED, None, text_of(error)))
            raise
        known = op.status in (GoalStatus.SUCCEEDED, GoalStatus.CANCELED)
        if op.status == GoalStatus.CANCELED and not self.goal.cancelled.is_set() and not self._session.gateway:
            known = False  # ROS 2 lets nothing end as cancelled that nobody asked to cancel
        self.end(Outcome(GoalStatus(op.status) if known else GoalStatus.ABORTED, payload))

    @property
    def has_ended(self) -> bool:
        """Whether the outcome is known."""
        return self._outcome.done()

    def end(self, outcome: Outcome) -> None:
        """End the goal."""
        if not self._outcome.done():
            self._outcome.set_result(outcome)
