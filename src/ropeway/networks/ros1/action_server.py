"""Actions that we serve: goals of actionlib's clients to handlers of ours."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Coroutine
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import DecodeError, RopewayError
from ropeway.graph.base import Undelivered
from ropeway.graph.calls import ActionHandlers, GoalStatus, Outcome, ServerGoal
from ropeway.networks.ros1.action_endpoints import ActionTypes, RawSubscription, publish_raw, subscribe_raw
from ropeway.networks.ros1.action_wire import (
    CANCEL_TYPE,
    EVENT_QOS,
    STATUS_QOS,
    STATUS_TYPE,
    Code,
    GoalId,
    Ros1GoalStatus,
    goal_bytes,
    read_cancel,
    read_goal,
    report_message,
    statuses_message,
)
from ropeway.networks.ros1.writer import RawPublisher
from ropeway.tasks import Chores, Supervised, end

if TYPE_CHECKING:
    from ropeway.networks.ros1.master_registration import MasterRegistration

__all__ = ["Ros1ActionServer"]

log = logging.getLogger("ropeway.ros1")

_STATUS_S: Final = 0.2  # as actionlib's servers: clients take silence for a server that has gone
_LISTED_S: Final = 5.0  # so long a goal that has ended is listed
_GOALS_LIMIT: Final = 10_000  # listed at a time; more are rejected
_EARLY_FEEDBACK: Final = 256  # before a goal is accepted; the oldest goes first


class _Tracked:
    """A goal, and how far it is."""

    def __init__(self, id: GoalId, goal: ServerGoal, early: deque[bytes]) -> None:
        self.id, self.goal, self.early = id, goal, early
        self.code = Code.PENDING
        self.text = ""
        self.ended_s = 0.0
        self.work: asyncio.Task[None] | None = None

    @property
    def status(self) -> Ros1GoalStatus:
        """The status as clients get it."""
        return Ros1GoalStatus(self.id, self.code, self.text)


class Ros1ActionServer:
    """An action served on a ``Ros1Graph``: see ``ropeway.graph.calls.ActionServer``. ``open`` begins."""

    def __init__(self, keeper: MasterRegistration, action: str, type: str, handlers: ActionHandlers) -> None:
        self.action, self.type = action, type
        self.closed = False
        self._keeper, self._node, self._handlers = keeper, keeper.node, handlers
        self._types = ActionTypes(keeper.node, type)
        self._goals: dict[str, _Tracked] = {}
        self._recalled: dict[str, float] = {}  # cancelled before they came, and when
        self._cancelled_ns = 0
        self._publishers: dict[str, RawPublisher] = {}
        self._subscriptions: list[RawSubscription] = []
        self._tasks = Chores()
        self._ticker: Supervised | None = None

    async def open(self) -> None:
        """Serve the action. What clients read comes first, so that who can send a goal can hear of it."""
        keeper, action, types = self._keeper, self.action, self._types
        try:
            for topic, type, qos in (
                ("status", STATUS_TYPE, STATUS_QOS),
                ("feedback", types.feedback, EVENT_QOS),
                ("result", types.result, EVENT_QOS),
            ):
                self._publishers[topic] = await publish_raw(keeper, f"{action}/{topic}", type, qos)
            for topic, type, take in (
                ("cancel", CANCEL_TYPE, self._take_cancel),
                ("goal", types.goal, self._take_goal),
            ):
                made = await subscribe_raw(keeper, f"{action}/{topic}", type, take, lambda: None)
                self._subscriptions.append(made)
        except BaseException:
            await self.close()
            raise
        self._ticker = Supervised(self._tick, f"status of {action}").start()

    async def close(self) -> None:
        """See ``ActionServer``."""
        if self.closed:
            return
        self.closed = True
        for tracked in list(self._goals.values()):
            if not tracked.code.final:
                self._finish(tracked, Code.ABORTED, None, "the action server was closed")
        await end(self._ticker)
        await self._tasks.close()
        for subscription in self._subscriptions:
            await subscription.close()
        for publisher in self._publishers.values():
            await publisher.close()

    # ── status ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def _tick(self) -> None:
        while True:
            self._publish_status()
            await asyncio.sleep(_STATUS_S)

    def _publish_status(self) -> None:
        oldest_s = asyncio.get_running_loop().time() - _LISTED_S
        for text, tracked in list(self._goals.items()):
            if tracked.code.final and tracked.ended_s < oldest_s:
                del self._goals[text]
        for text, came_s in list(self._recalled.items()):
            if came_s < oldest_s:
                del self._recalled[text]
        if (publisher := self._publishers.get("status")) is not None and not publisher.closed:
            publisher.publish_raw(statuses_message(goal.status for goal in self._goals.values()))

    # ── goals ──────────────────────────────────────────────────────────────────────────────────────────────────

    def _take_goal(self, raw: bytes, caller: str) -> None:
        id, body = read_goal(raw)
        if self.closed or id.text in self._goals:
            return
        if not id.text:
            id = GoalId(f"{caller}-{id.stamp_ns}-{time.time_ns()}", id.stamp_ns)
        early: deque[bytes] = deque(maxlen=_EARLY_FEEDBACK)
        goal = ServerGoal(b"", goal_bytes(id.text), early.append, caller=caller)
        tracked = _Tracked(id, goal, early)
        if len(self._goals) >= _GOALS_LIMIT:
            log.warning("%s: a goal is rejected, %d are listed already", self.action, len(self._goals))
            self._report("result", Ros1GoalStatus(id, Code.REJECTED, "too many goals"), self._result(None))
            return
        self._goals[id.text] = tracked
        try:
            goal.payload = self._types.of_goal.from_ros1(body)
        except DecodeError:
            self._finish(tracked, Code.REJECTED, None, "the goal is not readable")
            raise
        early_cancel = self._recalled.pop(id.text, None) is not None
        if early_cancel or (id.stamp_ns and id.stamp_ns <= self._cancelled_ns):
            self._finish(tracked, Code.RECALLED, None, "it was cancelled before it came")
            return
        self._publish_status()
        tracked.work = self._start(self._carry_out(tracked))

    def _start(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        return self._tasks.start(work, f"goal of {self.action}")

    async def _carry_out(self, tracked: _Tracked) -> None:
        if not await self._accepts(tracked):
            return
        tracked.code = Code.ACTIVE
        self._publish_status()
        tracked.goal.feedback = lambda payload: self._send_feedback(tracked, payload)
        while tracked.early:
            tracked.goal.feedback(tracked.early.popleft())
        try:
            outcome = await self._handlers.execute(tracked.goal)
        except asyncio.CancelledError:
            self._finish(tracked, Code.ABORTED, None, "it was given up")
            raise
        except Exception as error:  # a handler is somebody else's code; its failure aborts this goal
            self._blame("carrying out a goal", error)
            outcome = Outcome(GoalStatus.ABORTED, None, str(error) or type(error).__name__)
        self._finish(tracked, Code.of(outcome.status), outcome.payload, outcome.text)

    async def _accepts(self, tracked: _Tracked) -> bool:
        """Return whether a goal is to be carried out; if not, tell the clients that it has ended."""
        accepted = True
        if self._handlers.accept is not None:
            try:
                accepted = await self._handlers.accept(tracked.goal)
            except Exception as error:  # a handler is somebody else's code; its failure rejects this goal
                self._blame("accepting a goal", error)
                accepted = False
        if tracked.code is Code.RECALLING:
            self._finish(tracked, Code.RECALLED, None, "")
        elif not accepted:
            self._finish(tracked, Code.REJECTED, None, "Action goal was rejected")
        return accepted and tracked.code is Code.PENDING

    def _finish(self, tracked: _Tracked, code: Code, payload: bytes | None, text: str) -> None:
        if tracked.code.final:
            return
        try:
            body = self._result(payload)
        except DecodeError as error:
            log.error("%s: the result of a goal cannot be sent: %s", self.action, error)
            code, text, body = Code.ABORTED, str(error), self._result(None)
        tracked.code, tracked.text = code, text
        tracked.ended_s = asyncio.get_running_loop().time()
        self._report("result", tracked.status, body)
        self._publish_status()

    def _result(self, payload: bytes | None) -> bytes:
        return self._types.of_result.to_ros1(self._types.no_result if payload is None else bytes(payload))

    def _send_feedback(self, tracked: _Tracked, payload: bytes) -> None:
        drops, topic = self._node.graph.drops, f"{self.action}/feedback"
        if tracked.code.final:
            drops[topic, Undelivered.CLOSED] += 1
            return
        try:
            body = self._types.of_feedback.to_ros1(bytes(payload))
        except DecodeError as error:
            drops[topic, Undelivered.ENCODE] += 1
            log.warning("%s: a feedback cannot be sent: %s", self.action, error)
            return
        self._report("feedback", tracked.status, body)

    def _report(self, topic: str, status: Ros1GoalStatus, body: bytes) -> None:
        publisher = self._publishers.get(topic)
        if publisher is not None and not publisher.closed:
            publisher.publish_raw(report_message(status, body))

    # ── cancelling ─────────────────────────────────────────────────────────────────────────────────────────────

    def _take_cancel(self, raw: bytes, caller: str) -> None:
        asked = read_cancel(raw)
        everything = not asked.text and not asked.stamp_ns
        found = False
        for tracked in list(self._goals.values()):
            found = found or tracked.id.text == asked.text
            older = asked.stamp_ns and tracked.id.stamp_ns <= asked.stamp_ns
            if not (everything or older or tracked.id.text == asked.text):
                continue
            if tracked.code is Code.PENDING:
                tracked.code = Code.RECALLING
                self._publish_status()
            elif tracked.code is Code.ACTIVE:
                self._start(self._cancel(tracked))
        if asked.text and not found and len(self._recalled) < _GOALS_LIMIT:
            self._recalled[asked.text] = asyncio.get_running_loop().time()
        self._cancelled_ns = max(self._cancelled_ns, asked.stamp_ns)

    async def _cancel(self, tracked: _Tracked) -> None:
        if self._handlers.cancel is not None:
            try:
                if not await self._handlers.cancel(tracked.goal):
                    return
            except Exception as error:  # a handler is somebody else's code; its failure refuses the request
                self._blame("cancelling a goal", error)
                return
        if tracked.code is Code.ACTIVE:
            tracked.code = Code.PREEMPTING
            self._publish_status()
            tracked.goal.cancelled.set()

    def _blame(self, doing: str, error: Exception) -> None:
        if isinstance(error, RopewayError):
            log.warning("%s: %s failed: %s", self.action, doing, error)
        else:
            log.error("%s: %s failed", self.action, doing, exc_info=error)
