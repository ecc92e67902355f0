"""What a client does with actions: it uses those of the graph, and carries out goals for it."""

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
    RopewayError,
    TypeConflict,
    TypesError,
    WireError,
)
from ropeway.graph.base import Delivery, resolve_name
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, ActionHandlers, ClientGoal, Goal, GoalStatus, Outcome, ServerGoal
from ropeway.graph.rosbridge.failures import received
from ropeway.server.bodies import codec_of, decode_body, failure_note, passage, text_of
from ropeway.server.service_ops import tell_state
from ropeway.tasks import end
from ropeway.wire import ops

if TYPE_CHECKING:
    from ropeway.graph.hub_actions import ViewActionServer
    from ropeway.server.session import Session

__all__ = ["ActionOps"]

log = logging.getLogger("ropeway.server")

_GOALS_LIMIT: Final = 1024  # under way, of one client
_PENDING_LIMIT: Final = 1024  # under way, of one action of a client
_ACTIONS_LIMIT: Final = 1024  # of one client
_FEEDBACK_LIMIT_BYTES: Final = 1 << 20  # a client that does not read so much misses feedback
_LEAVE_S: Final = 2.0  # how long the goals of a client that left may take to be cancelled


class ActionOps:
    """The goals and the actions of one client."""

    def __init__(self, session: Session, *, cancel_goals: bool) -> None:
        self.session = session
        self.cancel_goals = cancel_goals
        self.goals: set[SentGoal] = set()
        self.offered: dict[str, OfferedAction] = {}  # by the name that the client gave
        self._tasks: set[asyncio.Task[None]] = set()

    async def leave(self) -> None:
        """The client has left: its goals are cancelled, its actions withdrawn."""
        if self.cancel_goals:
            for goal in list(self.goals):
                self._start(goal.cancel(), f"cancel goal of {goal.name}")
        cancelling = [task for task in self._tasks if not task.done()]
        if cancelling:
            await asyncio.wait(cancelling, timeout=_LEAVE_S)
        await end(*self._tasks, *(goal.task for goal in self.goals))
        for action in list(self.offered.values()):
            await action.close("its provider has left")
        self.offered.clear()

    def status(self) -> Iterator[dict[str, Any]]:
        """One row per action that the client serves."""
        for action in self.offered.values():
            yield {
                "name": action.action,
                "type": action.type,
                "goals": action.count,
                "pending": len(action.pending),
                "taken_by": action.taken_by,
            }

    def _start(self, work: Any, name: str) -> None:
        task = asyncio.create_task(work, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # ── using actions ──────────────────────────────────────────────────────────────────────────────────────────

    def send(self, op: ops.SendActionGoal) -> None:
        """The client sends a goal; it has exactly one result, unless the client leaves."""
        if len(self.goals) >= _GOALS_LIMIT:
            self.refuse(op, CallFailed(op.name, f"too many goals: {_GOALS_LIMIT} of this client are under way"))
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
        """A goal came that cannot be understood; it is answered if it says what it is about."""
        action = message.get("action")
        id = error.id if isinstance(error, InvalidOperation) else ops.ABSENT
        if isinstance(action, str) or ops.present(id):
            name = action if isinstance(action, str) else ""
            self.refuse(ops.SendActionGoal(action=name, action_type="", args=None, id=id), error)

    def cancel(self, op: ops.CancelActionGoal) -> None:
        """The client asks for the end of a goal, or without an id of all its goals of the action."""
        name = resolve_name(op.name)
        for goal in list(self.goals):
            if goal.name == name and (not ops.present(op.id) or goal.op.id == op.id):
                self._start(goal.cancel(answer=self.session.gateway), f"cancel goal of {name}")

    # ── serving actions ────────────────────────────────────────────────────────────────────────────────────────

    async def advertise(self, op: ops.AdvertiseAction) -> None:
        """The client carries out goals."""
        session = self.session
        name = resolve_name(op.action)
        session.access.check("advertise_action", name)
        type = session.registry.canonical(op.type, "action")
        if type.split("/")[1] != "action":
            raise InvalidTypeName(op.type)
        session.learn(type, op.ropeway)
        for part in ("_Goal", "_Result", "_Feedback"):
            codec_of(session, type + part)  # what the client cannot read, it cannot serve
        known = self.offered.get(op.action)
        if known is None and len(self.offered) >= _ACTIONS_LIMIT:
            raise InvalidOperation("", f"a client may have {_ACTIONS_LIMIT} actions at most")
        if known is not None:
            log.warning("%s: Duplicate action advertised. Overwriting %s.", session.peer.connection.peer, op.action)
            if known.type == type:  # the name stays taken meanwhile
                known.restart(op)
                return
            del self.offered[op.action]
            await known.close("it was advertised again with another type")
        action = self.offered[op.action] = OfferedAction(session, op, name, type)
        try:
            await action.open()
        except (RopewayError, ValueError):
            del self.offered[op.action]
            raise

    async def unadvertise(self, op: ops.UnadvertiseAction) -> None:
        """The client carries out goals no more."""
        action = self.offered.pop(op.action, None)
        if action is None:
            raise InvalidOperation("", f"Action {op.action} has not been advertised via rosbridge, can't unadvertise.")
        await action.close("its provider has withdrawn it")

    def feedback(self, op: ops.ActionFeedback) -> None:
        """The client tells how a goal goes on."""
        self._goal(op).feedback(op)

    def result(self, op: ops.ActionResult) -> None:
        """The client tells how a goal ended."""
        self._goal(op).ended(op)

    def _goal(self, op: ops.ActionFeedback | ops.ActionResult) -> TakenGoal:
        action = self.offered.get(op.action)
        if action is None:
            name = resolve_name(op.action)
            action = next((a for a in self.offered.values() if a.name == name), None)
        if action is None:
            raise InvalidOperation("", f"Action {op.action} has not been advertised via rosbridge.")
        goal = action.pending.get(op.id) if isinstance(op.id, str) else None
        if goal is None:
            what = op.op.replace("_", " ")
            raise InvalidOperation("", f"Received {what} for unrecognized id: {str(op.id)[:200]}")
        return goal

    def invalid_result(self, message: Mapping[str, Any], error: WireError) -> None:
        """A result came that cannot be understood: the goal is aborted."""
        id = message.get("id")
        for action in self.offered.values():
            if isinstance(id, str) and (goal := action.pending.get(id)) is not None:
                goal.end(Outcome(GoalStatus.ABORTED, None, text_of(error)))

    def control(self, message: Mapping[str, Any]) -> None:
        """A gateway that carries out a goal says that it takes it, or whether it agrees to its end."""
        id = message.get("id")
        for action in self.offered.values():
            if isinstance(id, str) and (goal := action.pending.get(id)) is not None:
                if message.get("op") == "accepted":
                    goal.accepted()
                else:
                    goal.cancelling(message.get("agreed") is not False)


class SentGoal:
    """A goal of the client."""

    def __init__(self, actions: ActionOps, op: ops.SendActionGoal) -> None:
        self.op = op
        self.name = op.name if op.name.startswith("/") else f"/{op.name}"
        self._actions, self._session = actions, actions.session
        self._goal: asyncio.Future[ClientGoal | None] = asyncio.get_running_loop().create_future()
        self.task = asyncio.create_task(self._run(), name=f"goal of {op.action[:200]}")

    async def _run(self) -> None:
        try:
            await self._carry_out()
        except (RopewayError, ValueError) as error:
            self._actions.refuse(self.op, error)
        finally:
            if not self._goal.done():
                self._goal.set_result(None)

    async def _carry_out(self) -> None:
        op, session = self.op, self._session
        extra = op.ropeway or {}
        name = resolve_name(op.name)
        session.access.check("send_action_goal", name)
        type = session.registry.canonical(op.action_type, "action")
        if type.split("/")[1] != "action":
            raise InvalidTypeName(op.action_type)
        session.learn(type, extra)
        info = session.view.actions().get(name)
        if info is not None and info.types and type not in info.types:
            raise TypeConflict(name, info.types[0], type)
        payload = decode_body(session, op.args, op.compression, type + "_Goal")
        codecs = [codec_of(session, type + part) for part in ("_Result", "_Feedback")]
        encoding = str(extra.get("encoding") or "auto")
        client = await session.view.create_action_client(name, type)
        try:
            goal = await client.send_goal(
                Goal(payload, **passage(session, extra)),
                on_feedback=lambda payload: self._feedback(payload, codecs[1], encoding),
                timeout_s=DEFAULT_TIMEOUT_S,
            )
            self._goal.set_result(goal)
            if session.gateway:
                session.peer.send_op({"op": "accepted", "id": op.id if ops.present(op.id) else None})
            outcome = await goal.result()
        finally:
            await client.close()
        self._result(outcome, type, codecs[0], encoding)

    def _feedback(self, payload: bytes, codec: Any, encoding: str) -> None:
        op, session = self.op, self._session
        if not op.feedback:
            return
        if session.peer.connection.unsent_bytes > _FEEDBACK_LIMIT_BYTES:
            session.peer.complaints.note("action_feedback", op.action, "feedback is not read")
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
        rejected = GoalRejected(self.name)
        if payload is None and outcome.text == str(rejected):  # from a network that tells it so late
            raise rejected
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
            self._session.peer.send_op({"op": "cancelling", "id": self.op.id, "agreed": agreed})


class OfferedAction:
    """An action that the client serves; ``action`` is its name as the client gave it, ``name`` that on the graph."""

    def __init__(self, session: Session, op: ops.AdvertiseAction, name: str, type: str) -> None:
        self.session, self.action, self.name, self.type = session, op.action, name, type
        self.pending: dict[str, TakenGoal] = {}
        self.count = 0
        self.taken_by = ""
        self.given_type, self.compression = op.type, op.compression
        self._goals: dict[bytes, TakenGoal] = {}
        self._inner: ViewActionServer | None = None

    async def open(self) -> None:
        """Serve it on the graph, or wait until whoever does leaves. Raises what the graph raises."""
        handlers = ActionHandlers(self._execute, self._accept, self._cancel if self.session.gateway else None)
        delivery = Delivery(encoding=self.compression or "auto")
        self._inner = await self.session.view.create_action_server(self.name, self.type, handlers, delivery=delivery)
        self._inner.on_state(self._state)

    def _state(self, taken_by: str) -> None:
        tell_state(self.session, "action", self.action, self.taken_by, taken_by)
        self.taken_by = taken_by

    def restart(self, op: ops.AdvertiseAction) -> None:
        """The client advertised it once more: its goals end here."""
        self.abort_all("its provider began anew")
        self.given_type, self.compression = op.type, op.compression
        self.count = 0

    async def _accept(self, goal: ServerGoal) -> bool:
        """A plain client takes every goal; a gateway asks further on."""
        if self.session.gone or len(self.pending) >= _PENDING_LIMIT:
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
        """Carry out no more goals; those under way are aborted."""
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
            op.ropeway = {
                "call": self.goal.id.hex(),
                "via": [*self.goal.via, session.gateway_id],
                "caller": self.goal.caller,
            }
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
        """The gateway takes it."""
        self.is_accepted = True
        if not self._answer.done():
            self._answer.set_result(True)

    async def wait_accepted(self) -> bool:
        """Whether the gateway takes it; what it is aborted with before is no acceptance."""
        waited: set[asyncio.Future[Any]] = {self._answer, self._outcome}
        await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
        if self._answer.done():
            return self._answer.result()
        text = self._outcome.result().text
        if text and text != str(GoalRejected("")):
            raise CallFailed(self._action.name, text)
        return False

    async def run(self) -> Outcome:
        """How it ends."""
        asked = asyncio.ensure_future(self.goal.cancelled.wait())
        try:
            waited: set[asyncio.Future[Any]] = {asked, self._outcome}
            await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED)
            if not self._outcome.done() and not self._session.gateway:
                self._session.peer.send_op(ops.CancelActionGoal(id=self.id, action=self._action.action))
            await asyncio.wait({self._outcome})
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
        """The gateway answers whether it agrees to the end."""
        if self._agreed is not None and not self._agreed.done():
            self._agreed.set_result(agreed)

    def feedback(self, op: ops.ActionFeedback) -> None:
        """The client tells how it goes on. Raises ``TypesError``."""
        if op.values is None:
            raise InvalidOperation("", "Expected a values field but none was found.")
        self.goal.feedback(decode_body(self._session, op.values, op.compression, self._action.type + "_Feedback"))

    def ended(self, op: ops.ActionResult) -> None:
        """The client tells how it ended. Raises ``TypesError``, and the goal is aborted."""
        name = self._action.name
        if not op.result or isinstance(op.values, str):
            status = GoalStatus.CANCELED if op.result and op.status == GoalStatus.CANCELED else GoalStatus.ABORTED
            if self._session.gateway and op.status in (GoalStatus.SUCCEEDED, GoalStatus.CANCELED):
                status = GoalStatus(op.status)
            text = str(received(name, op.values, op.ropeway, kind="action", timeout_s=0.0)) if op.values else ""
            self.end(Outcome(status, None, text))
            return
        try:
            payload = decode_body(self._session, op.values, op.compression, self._action.type + "_Result")
        except (TypesError, WireError) as error:
            self.end(Outcome(GoalStatus.ABORTED, None, text_of(error)))
            raise
        known = op.status in (GoalStatus.SUCCEEDED, GoalStatus.CANCELED)
        self.end(Outcome(GoalStatus(op.status) if known else GoalStatus.ABORTED, payload))

    def end(self, outcome: Outcome) -> None:
        """It has ended."""
        if not self._outcome.done():
            self._outcome.set_result(outcome)
