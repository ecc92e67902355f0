"""Actions served over a link. They outlive connections: each new one announces them."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import CallFailed, GoalRejected, LinkError, ProviderLost, RopewayError
from ropeway.graph.base import Delivery, Undelivered
from ropeway.graph.calls import ActionHandlers, GoalStatus, Outcome, ServerGoal
from ropeway.logs import failed
from ropeway.networks.rosbridge.client.call_notes import failure, read_note
from ropeway.networks.rosbridge.client.calls import answer_encoding
from ropeway.networks.rosbridge.client.provider import LinkProvider
from ropeway.networks.rosbridge.client.services import CALLS_LIMIT
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY, ROSGW
from ropeway.tasks import Chores

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.client.calls import Calls
    from ropeway.networks.rosbridge.link.peer import Peer

__all__ = ["RemoteActionServer"]

log = logging.getLogger("ropeway.rosbridge")

_FAILED: Final[dict[str, Any]] = {"error": "failed"}
_WITHDRAWN: Final = "who offered it has withdrawn it"


class _Goal:
    """A goal under way; ``key`` is its id on the link."""

    def __init__(self, op: ops.SendActionGoal, peer: Peer, key: str) -> None:
        self.op, self.peer, self.key = op, peer, key
        self.id = b""
        self.goal: ServerGoal | None = None  # once it is accepted
        self.decided = asyncio.Event()
        self.ended = False


class RemoteActionServer(LinkProvider):
    """An action that we serve on the far graph."""

    kind = "action"
    parts = ("Goal", "Result", "Feedback")

    def __init__(self, calls: Calls, action: str, type: str, handlers: ActionHandlers, delivery: Delivery) -> None:
        super().__init__(calls, action, type, delivery)
        self.action = action
        self._handlers = handlers
        self._goals: dict[str, _Goal] = {}
        self._tasks = Chores()

    # ── the connection ─────────────────────────────────────────────────────────────────────────────────────────

    def connected(self, peer: Peer) -> None:
        """Announce the action on a new connection. Raises ``UnknownType`` if the peer needs the definition."""
        about = self._announcing(peer)
        peer.send(ops.AdvertiseAction(action=self.action, type=self.type, **about))

    def disconnected(self) -> None:
        """Abort the goals: the connection is gone, so nobody follows them."""
        self._peer = None
        for goal in self._goals.values():
            goal.ended = True
        self._tasks.cancel()

    # ── what the peer asks for ─────────────────────────────────────────────────────────────────────────────────

    def asked(self, op: ops.SendActionGoal, peer: Peer) -> None:
        """Take a goal."""
        self._asked = op.compression
        goal = _Goal(op, peer, repr(op.id))
        if goal.key in self._goals or len(self._goals) >= CALLS_LIMIT:
            reason = "works at it already" if goal.key in self._goals else f"is busy with {CALLS_LIMIT} goals"
            self._fail(goal, CallFailed(self.action, f"{self.action} {reason}"))
            return
        self._goals[goal.key] = goal
        task = self._tasks.start(self._carry_out(goal), f"goal of {self.action}")
        task.add_done_callback(lambda _: self._goals.pop(goal.key, None))

    def cancel_asked(self, op: ops.CancelActionGoal, peer: Peer) -> None:
        """Take a request to cancel a goal."""
        self._tasks.start(self._cancel(op, peer), f"cancel goal of {self.action}")

    async def _carry_out(self, goal: _Goal) -> None:
        try:
            made = await self._accept(goal)
            if goal.ended:
                return
            goal.goal = made
            if goal.peer.dialect is ROPEWAY and ops.present(goal.op.id):
                goal.peer.send_op({"op": "accepted", "id": goal.op.id})
            goal.decided.set()
            outcome = await self._handlers.execute(made)
        except RopewayError as error:
            self._fail(goal, error)
        except Exception as error:  # a handler is somebody else's code; its failure is the goal's
            failed(log, "%s: the handler of %s failed", self._calls.graph.name, self.action)
            self._fail(goal, error)
        else:
            self._end(goal, outcome)
        finally:
            goal.decided.set()

    async def _accept(self, goal: _Goal) -> ServerGoal:
        op, note = goal.op, read_note(goal.op.ropeway)
        if any(other.id == note.id for other in self._goals.values()):
            raise GoalRejected(self.action)  # the same goal, by another way
        goal.id = note.id
        payload = self._calls.bodies.of(f"{self.type}_Goal").read(op.args, op.compression, goal.peer.limit_bytes)
        made = ServerGoal(payload, note.id, lambda data: self._feed(goal, data), note.via, note.caller)
        if self._handlers.accept is not None and not await self._handlers.accept(made):
            raise GoalRejected(self.action)
        return made

    async def _cancel(self, op: ops.CancelActionGoal, peer: Peer) -> None:
        agreed = False
        goal = self._goals.get(repr(op.id))
        if goal is not None:
            await goal.decided.wait()
            made = goal.goal
            if made is not None and not goal.ended:
                agreed = await self._agrees(made)
                if agreed:
                    made.cancelled.set()
        if peer.dialect is ROPEWAY and ops.present(op.id):
            peer.send_op({"op": "cancelling", "id": op.id, "agreed": agreed})

    async def _agrees(self, goal: ServerGoal) -> bool:
        if self._handlers.cancel is None:
            return True
        try:
            return await self._handlers.cancel(goal)
        except RopewayError as error:
            log.warning("%s: a goal of %s is not cancelled: %s", self._calls.graph.name, self.action, error)
        except Exception:  # a handler is somebody else's code
            failed(log, "%s: the handler of %s failed", self._calls.graph.name, self.action)
        return False

    # ── what the peer is told ──────────────────────────────────────────────────────────────────────────────────

    def _feed(self, goal: _Goal, payload: bytes) -> None:
        peer = goal.peer
        if goal.ended or not (goal.op.feedback or peer.dialect is ROSGW):  # which does not ask, and wants it
            return
        body = self._calls.bodies.of(f"{self.type}_Feedback")
        try:
            peer.send_op(
                ops.ActionFeedback(id=goal.op.id, action=goal.op.action, values=None),
                payload=body.written(payload),
                field="values",
                codec=body.codec,
                encoding=answer_encoding(self.delivery, peer, goal.op),
                priority=self._lane,
            )
        except RopewayError as error:
            reason = Undelivered.WRITE if isinstance(error, LinkError) else Undelivered.ENCODE
            self._calls.graph.drops[self.action, reason] += 1
            peer.fault_log.note("feedback", self.action, error)

    def _end(self, goal: _Goal, outcome: Outcome) -> None:
        if goal.ended:
            return
        status = outcome.status if outcome.status.final else GoalStatus.ABORTED
        if outcome.payload is None:
            self._end_empty(goal, status, _FAILED, outcome.text)
            return
        body = self._calls.bodies.of(f"{self.type}_Result")
        try:
            goal.peer.send_op(
                self._result(goal, status, None),
                payload=body.written(outcome.payload),
                field="values",
                codec=body.codec,
                encoding=answer_encoding(self.delivery, goal.peer, goal.op),
                priority=self._lane,
                on_unsent=lambda error: self._end_empty(goal, GoalStatus.ABORTED, _FAILED, str(error)),
            )
            goal.ended = True
        except RopewayError as error:
            self._end_empty(goal, GoalStatus.ABORTED, _FAILED, str(error))

    def _fail(self, goal: _Goal, error: BaseException) -> None:
        note, text = failure(error)
        taken = goal.goal is not None
        self._end_empty(goal, GoalStatus.ABORTED if taken else GoalStatus.UNKNOWN, note, text)

    def _end_empty(self, goal: _Goal, status: GoalStatus, note: dict[str, Any], text: str) -> None:
        """Tell of an end without a result: to gateways with the reason, to others with an empty one."""
        goal.ended = True
        if goal.peer.dialect is ROPEWAY:
            made = self._result(goal, status, text)
            made.result, made.ropeway = False, note
        else:
            made = self._result(goal, status if status.final else GoalStatus.ABORTED, {})
        goal.peer.send_op(made)

    def _result(self, goal: _Goal, status: GoalStatus, values: object) -> ops.ActionResult:
        rosgw = goal.peer.dialect is ROSGW  # it knows success and failure only
        result = status is GoalStatus.SUCCEEDED if rosgw else True
        return ops.ActionResult(id=goal.op.id, action=goal.op.action, values=values, status=int(status), result=result)

    async def close(self) -> None:
        """See ``ActionServer``."""
        if self.closed:
            return
        self.closed = True
        self._calls.servers.pop(self.action, None)
        peer, self._peer = self._peer, None
        if peer is not None:
            for goal in list(self._goals.values()):
                if not goal.ended:
                    self._fail(goal, ProviderLost(self.action, _WITHDRAWN))
            peer.send(ops.UnadvertiseAction(id=self.id, action=self.action))
        await self._tasks.close()
