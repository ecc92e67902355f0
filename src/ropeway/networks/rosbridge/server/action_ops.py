"""Carries out a client's operations on actions: it uses those of the graph, and carries out goals for it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import (
    CallFailed,
    GoalRejected,
    GraphError,
    InvalidOperation,
    InvalidTypeName,
    ProviderLost,
    RopewayError,
    TypeConflict,
    WireError,
)
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, ClientGoal, Goal, GoalStatus, Outcome
from ropeway.limits import ACTIONS_PER_CLIENT, GOALS_PER_CLIENT, UNREAD_STATUS_BYTES
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.dialect import ROSGW
from ropeway.networks.rosbridge.server.action_offers import OfferedAction, TakenGoal
from ropeway.networks.rosbridge.server.bodies import (
    answer_encoding,
    codec_of,
    decode_args,
    failure_note,
    known_type_of,
    passage,
    text_of,
)
from ropeway.networks.rosbridge.server.offers import Offers
from ropeway.tasks import Chores, end

if TYPE_CHECKING:
    from ropeway.hub.actions import ViewActionClient
    from ropeway.networks.rosbridge.server.host import SessionHost

__all__ = ["ActionOps"]

log = logging.getLogger("ropeway.server")

_LEAVE_S: Final = 2.0  # how long the goals of a client that left may take to be cancelled


class ActionOps:
    """The goals and the actions of one client."""

    def __init__(self, session: SessionHost, *, cancel_goals: bool = True) -> None:
        self.session = session
        self._cancel_goals = cancel_goals
        self.goals: set[SentGoal] = set()
        self.offered: Offers[OfferedAction] = Offers(
            session, "action", "action", ("Goal", "Result", "Feedback"), ACTIONS_PER_CLIENT
        )
        self._cancelling = Chores()

    async def leave(self) -> None:
        """Clean up after a client that has left: its goals are cancelled, unless they may go on, and its actions
        withdrawn.
        """
        await self._cancel_all()
        await self._cancelling.close()
        await end(*(goal.task for goal in self.goals))
        await self.offered.leave()

    async def give_up(self, reason: str) -> None:
        """Answer the goals that are under way: they are cancelled, and fail for this reason if nothing else comes."""
        await self._cancel_all()
        under_way = list(self.goals)
        await end(*(goal.task for goal in under_way))
        for goal in under_way:
            self.refuse(goal.op, ProviderLost(goal.name, reason))

    async def _cancel_all(self) -> None:
        for goal in list(self.goals) if self._cancel_goals else ():
            self._cancelling.start(goal.cancel(), f"cancel goal of {goal.name}")
        await self._cancelling.wait(_LEAVE_S)

    def status(self) -> Iterator[dict[str, Any]]:
        """Yield one row per action that the client serves."""
        for action in self.offered.values():
            yield {
                "name": action.action,
                "type": action.type,
                "goals": action.count,
                "pending": len(action.pending),
                "taken_by": action.taken_by,
            }

    # ── using actions ──────────────────────────────────────────────────────────────────────────────────────────

    def send(self, op: ops.SendActionGoal) -> None:
        """Send a goal of the client; it has exactly one result, unless the client leaves."""
        if len(self.goals) >= GOALS_PER_CLIENT:
            self.refuse(op, CallFailed(op.name, f"too many goals: {GOALS_PER_CLIENT} of this client are under way"))
            return
        goal = SentGoal(self, op)
        self.goals.add(goal)
        goal.task.add_done_callback(partial(self._ended, goal))

    def _ended(self, goal: SentGoal, task: asyncio.Task[None]) -> None:
        self.goals.discard(goal)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("%s: a goal of %s failed", self.session.peer.connection.peer, goal.name, exc_info=error)
            self.refuse(goal.op, CallFailed(goal.name, "internal error"))

    def refuse(self, op: ops.SendActionGoal, error: Exception) -> None:
        """Answer a goal that is not carried out."""
        note = failure_note(self.session, error)
        values = text_of(error)
        reply = ops.ActionResult(action=op.action, values=values, status=0, result=False, id=op.id, ropeway=note)
        self.session.peer.send_op(reply)

    def invalid_goal(self, message: Mapping[str, Any], error: WireError) -> None:
        """Answer a goal that cannot be understood, if it says what it is about."""
        action = message.get("action")
        id = error.id if isinstance(error, InvalidOperation) else ops.ABSENT
        if isinstance(action, str) or ops.present(id):
            name = action if isinstance(action, str) else ""
            self.refuse(ops.SendActionGoal(action=name, action_type="", args=None, id=id), error)

    def cancel(self, op: ops.CancelActionGoal) -> None:
        """Cancel a goal of the client, or without an id all its goals of the action."""
        name = self.session.names.resolve(op.name)
        self.session.access.command("cancel_action_goal", name)
        found = [g for g in self.goals if g.name == name and (not ops.present(op.id) or g.op.id == op.id)]
        for goal in found:
            self._cancelling.start(goal.cancel(answer=self.session.gateway), f"cancel goal of {name}")
        if not found and self.session.gateway:
            self.session.peer.send_op({"op": "cancelling", **_id(op), "agreed": False})

    # ── serving actions ────────────────────────────────────────────────────────────────────────────────────────

    async def advertise(self, op: ops.AdvertiseAction) -> None:
        """Offer an action whose goals the client carries out."""
        await self.offered.add(op, partial(OfferedAction, self.session, op), lambda action: action.restart(op))

    async def unadvertise(self, op: ops.UnadvertiseAction) -> None:
        """Withdraw an action of the client."""
        await self.offered.withdraw(op.action)

    def feedback(self, op: ops.ActionFeedback) -> None:
        """Pass on the client's feedback on a goal."""
        self._goal(op).feedback(op)

    def result(self, op: ops.ActionResult) -> None:
        """Take the client's result of a goal."""
        self._goal(op).ended(op)

    def _goal(self, op: ops.ActionFeedback | ops.ActionResult) -> TakenGoal:
        action = self.offered.found(op.action)
        goal = action.pending.get(op.id) if isinstance(op.id, str) else None
        if goal is None or goal.has_ended:
            what = op.op.replace("_", " ")
            raise InvalidOperation("", f"Received {what} for unrecognized id: {str(op.id)[:200]}")
        return goal

    def invalid_result(self, message: Mapping[str, Any], error: WireError) -> None:
        """Abort a goal whose result cannot be understood."""
        id = message.get("id")
        for action in self.offered.values():
            if isinstance(id, str) and (goal := action.pending.get(id)) is not None:
                goal.end(Outcome(GoalStatus.ABORTED, None, text_of(error)))

    def control(self, message: Mapping[str, Any]) -> None:
        """Handle a gateway's word on a goal that it carries out: whether it accepts it, or its cancellation."""
        id = message.get("id")
        for action in self.offered.values():
            if isinstance(id, str) and (goal := action.pending.get(id)) is not None:
                if message.get("op") == "accepted":
                    goal.accepted()
                else:
                    goal.cancelling(message.get("agreed") is True)


class SentGoal:
    """A goal of the client."""

    def __init__(self, actions: ActionOps, op: ops.SendActionGoal) -> None:
        self.op = op
        self.name = op.name if op.name.startswith("/") else f"/{op.name}"
        self._actions, self._session = actions, actions.session
        self._goal: asyncio.Future[ClientGoal | None] = asyncio.get_running_loop().create_future()
        self.task = asyncio.create_task(self._run(), name=f"goal of {op.action[:200]}")
        self.task.add_done_callback(self._done)

    async def _run(self) -> None:
        try:
            await self._carry_out()
        except (RopewayError, ValueError) as error:
            self._actions.refuse(self.op, error)

    def _done(self, _: asyncio.Task[None]) -> None:
        """Release those who wait for the goal, also if the task was cancelled before it began."""
        if not self._goal.done():
            self._goal.set_result(None)

    async def _carry_out(self) -> None:
        op, session = self.op, self._session
        extra = op.ropeway or {}
        name = session.names.resolve(op.name)
        session.access.check("send_action_goal", name)
        type = await known_type_of(session, op.action_type, "action")
        if type.split("/")[1] != "action":
            raise InvalidTypeName(op.action_type)
        session.learn(type, extra)
        types = session.view.action_types(name)
        if types and type not in types:
            raise TypeConflict(name, types[0], type)
        payload = decode_args(session, op.args, op.compression, type + "_Goal")
        session.access.command("send_action_goal", name, payload)
        op.args = None  # in CDR it takes least
        codecs = [codec_of(session, type + part) for part in ("_Result", "_Feedback")]
        encoding = answer_encoding(session, op)
        goal = Goal(payload, *passage(session, extra))
        session.requests_bytes += len(payload)
        try:
            client = await self._client(name, type, found=bool(types))
            try:
                sent = await client.send_goal(
                    goal,
                    on_feedback=lambda payload: self._feedback(payload, codecs[1], encoding),
                    timeout_s=DEFAULT_TIMEOUT_S,
                )
                self._goal.set_result(sent)
                if session.gateway:
                    session.peer.send_op({"op": "accepted", **_id(op)})
                outcome = await sent.result()
            finally:
                await client.close()
        finally:
            session.requests_bytes -= len(payload)
        self._result(outcome, type, codecs[0], encoding)

    async def _client(self, name: str, type: str, *, found: bool) -> ViewActionClient:
        """Return a client for an action; where nobody is known to serve it, somebody may appear in a moment.

        Raises ``NotServed`` or ``CallTimeout``. Few are looked for at a time: each takes parts of the graph.
        """
        view = self._session.view
        if found:
            return await view.create_action_client(name, type)
        async with self._session.searching(name, DEFAULT_TIMEOUT_S):
            client = await view.create_action_client(name, type)
            try:
                await client.find(DEFAULT_TIMEOUT_S)
            except BaseException:
                await client.close()
                raise
            return client

    def _feedback(self, payload: bytes, codec: Any, encoding: str) -> None:
        op, session = self.op, self._session
        if not op.feedback and session.peer.dialect is not ROSGW:  # which does not ask, and wants it
            return
        if session.peer.connection.unsent_bytes > UNREAD_STATUS_BYTES:
            session.peer.fault_log.note("action_feedback", op.action, "feedback is not read")
            return
        session.peer.send_op(
            ops.ActionFeedback(action=op.action, values=None, id=op.id),
            payload=payload,
            field="values",
            codec=codec,
            encoding=encoding,
            fragment_size=op.fragment_size,
        )

    def _result(self, outcome: Outcome, type: str, codec: Any, encoding: str) -> None:
        op, session = self.op, self._session
        payload = outcome.payload
        if outcome.rejected:
            raise GoalRejected(self.name)
        if payload is None and session.gateway:
            values = outcome.text or "the goal has no result"
            session.peer.send_op(
                ops.ActionResult(
                    action=op.action,
                    values=values,
                    status=int(outcome.status),
                    result=False,
                    id=op.id,
                    ropeway={"error": "failed"},
                )
            )
            return
        if payload is None:
            payload = session.registry.codec(type + "_Result").from_json({})
            if outcome.text:
                session.inform(f"the goal of {op.action} was aborted: {outcome.text}", op.id)
        session.peer.send_op(
            ops.ActionResult(action=op.action, values=None, status=int(outcome.status), result=True, id=op.id),
            payload=payload,
            field="values",
            codec=codec,
            encoding=encoding,
            fragment_size=op.fragment_size,
            on_unsent=partial(self._actions.refuse, op),
        )

    async def cancel(self, *, answer: bool = False) -> None:
        """Ask for its end, as soon as it is accepted; ``answer`` tells whether the client wants to know the reply."""
        agreed = False
        try:
            goal = await asyncio.shield(self._goal)
            if goal is not None:
                agreed = await goal.cancel()
        except GraphError as error:
            self._session.complain("cancel_action_goal", self.name, error, self.op.id)
        if answer:
            self._session.peer.send_op({"op": "cancelling", **_id(self.op), "agreed": agreed})


def _id(op: ops.CancelActionGoal | ops.SendActionGoal) -> dict[str, Any]:
    return {"id": op.id} if ops.present(op.id) else {}
