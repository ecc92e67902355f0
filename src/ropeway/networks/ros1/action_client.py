"""Actions that we use: goals of ours to an action server of actionlib."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from ropeway import aio
from ropeway.errors import (
    CallError,
    CallFailed,
    CallTimeout,
    DecodeError,
    GoalRejected,
    GraphUnavailable,
    NotServed,
    ProviderLost,
)
from ropeway.graph.base import Undelivered
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Goal, GoalStatus, Outcome
from ropeway.graph.signal import Signal
from ropeway.logs import failed
from ropeway.networks.ros1.action_endpoints import ActionTypes, RawSubscription, publish_raw, subscribe_raw
from ropeway.networks.ros1.action_wire import (
    CANCEL_TYPE,
    EVENT_QOS,
    STATUS_TYPE,
    Code,
    GoalId,
    cancel_message,
    goal_message,
    goal_text,
    read_report,
    read_statuses,
)
from ropeway.networks.ros1.writer import RawPublisher
from ropeway.tasks import settled

if TYPE_CHECKING:
    from ropeway.networks.ros1.master_registration import MasterRegistration

__all__ = ["Ros1ActionClient", "Ros1Goal"]

log = logging.getLogger("ropeway.ros1")

_GONE_S: Final = 0.5  # a server whose connections are lost may be back so soon
_RESULT_S: Final = 2.0  # a goal that is said to have ended gets its result within this
_SETTLE_S: Final = 0.01  # feedback comes over another connection: what was sent before the result may lag so much
_REFUSED_S: Final = 1.0  # a goal that is active so long after a request to cancel goes on
_JOINED_S: Final = 0.05  # rospy answers a subscriber a moment before it begins to send to it
_GONE: Final = "the action server has gone"


class Ros1Goal:
    """A goal that was sent; its users get it when it is accepted."""

    def __init__(self, client: Ros1ActionClient, id: bytes, on_feedback: Callable[[bytes], None] | None) -> None:
        loop = asyncio.get_running_loop()
        self.id, self.text = id, goal_text(id)
        self.code = Code.PENDING
        self.heard = 0  # how often its server told its status
        self.server: str | None = None
        self.on_feedback = on_feedback
        self.accepted: asyncio.Future[None] = loop.create_future()
        self.outcome: asyncio.Future[Outcome] = loop.create_future()
        self.expiry: asyncio.TimerHandle | None = None
        self.news = asyncio.Event()
        self._client = client

    def refuse(self, error: CallError | GraphUnavailable) -> None:
        """Reject the goal: it will not be accepted any more."""
        if not self.accepted.done():
            self.accepted.set_exception(error)
            self.accepted.exception()  # its sender may have left
        self.news.set()

    def finish(self, outcome: Outcome) -> None:
        """End the goal."""
        if not self.accepted.done():
            self.accepted.set_result(None)
        if not self.outcome.done():
            self.outcome.set_result(outcome)
        if self.expiry is not None:
            self.expiry.cancel()
        self.news.set()

    async def result(self, timeout_s: float | None = None) -> Outcome:
        """See ``ClientGoal``."""
        if not await settled(self.outcome, timeout_s):
            assert timeout_s is not None
            raise CallTimeout(self._client.action, timeout_s, "action")
        return self.outcome.result()

    async def cancel(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> bool:
        """See ``ClientGoal``. A goal that goes on for a second is taken for one whose end was refused."""
        return await self._client.cancel(self, timeout_s)


class Ros1ActionClient:
    """An action used on a ``Ros1Graph``: see ``ropeway.graph.calls.ActionClient``. ``open`` begins."""

    def __init__(self, keeper: MasterRegistration, action: str, type: str) -> None:
        self.action, self.type = action, type
        self.closed = False
        self._keeper, self._node = keeper, keeper.node
        self._types = ActionTypes(keeper.node, type)
        self._publishers: list[RawPublisher] = []
        self._subscriptions: list[RawSubscription] = []
        self._goals: dict[str, Ros1Goal] = {}
        self._changed = Signal()
        self._gone: asyncio.TimerHandle | None = None
        self._joined: asyncio.TimerHandle | None = None
        self._joined_s = 0.0

    async def open(self) -> None:
        """Join the five topics."""
        keeper, action, types = self._keeper, self.action, self._types
        try:
            for topic, type, take in (
                ("status", STATUS_TYPE, self._take_status),
                ("feedback", types.feedback, self._take_feedback),
                ("result", types.result, self._take_result),
            ):
                made = await subscribe_raw(keeper, f"{action}/{topic}", type, take, self._links_changed)
                self._subscriptions.append(made)
            for topic, type in (("cancel", CANCEL_TYPE), ("goal", types.goal)):
                publisher = await publish_raw(keeper, f"{action}/{topic}", type, EVENT_QOS)
                self._publishers.append(publisher)
                publisher.on_demand(lambda _: self._links_changed())
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See ``ActionClient``."""
        if self.closed:
            return
        self.closed = True
        for timer in (self._gone, self._joined):
            if timer is not None:
                timer.cancel()
        for goal in list(self._goals.values()):
            if not goal.accepted.done():
                why = f"the client of {self.action} was closed in mid-call"
                goal.refuse(GraphUnavailable(self._node.graph.name, why))
            goal.finish(Outcome(GoalStatus.ABORTED, None, "the action client was closed"))
        self._goals.clear()
        self._changed.notify()
        for publisher in self._publishers:
            await publisher.close()
        for subscription in self._subscriptions:
            await subscription.close()

    # ── the server ─────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def available(self) -> bool:
        """Whether all five topics are connected, and have been for a moment."""
        return self._complete and asyncio.get_running_loop().time() >= self._joined_s

    @property
    def _complete(self) -> bool:
        return (
            not self.closed
            and len(self._publishers) == 2
            and all(publisher.subscribers for publisher in self._publishers)
            and all(subscription.publishers for subscription in self._subscriptions)
        )

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``ActionClient``."""
        self._check()
        await self._changed.wait_for(lambda: self.closed or self.available, timeout_s)
        return self.available

    def _links_changed(self) -> None:
        loop = asyncio.get_running_loop()
        if self._complete:
            if self._joined is None:
                self._joined_s = loop.time() + _JOINED_S
                self._joined = loop.call_at(self._joined_s, self._changed.notify)
            return
        if self._joined is not None:
            self._joined.cancel()
            self._joined = None
        self._changed.notify()
        if self._gone is None and not self.closed and self._goals:
            self._gone = loop.call_later(_GONE_S, self._check_gone)

    def _check_gone(self) -> None:
        self._gone = None
        if self._complete:
            return
        for goal in list(self._goals.values()):
            if not goal.accepted.done():
                goal.refuse(ProviderLost(self.action, _GONE))
            self._finish(goal, Outcome(GoalStatus.ABORTED, None, _GONE))

    def _check(self) -> None:
        if self.closed:
            raise GraphUnavailable(self._node.graph.name, f"the client of {self.action} is closed")

    # ── goals ──────────────────────────────────────────────────────────────────────────────────────────────────

    async def send_goal(
        self,
        goal: Goal,
        *,
        on_feedback: Callable[[bytes], None] | None = None,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> Ros1Goal:
        """See ``ActionClient``. A goal that its sender does not wait for any more is cancelled."""
        self._check()
        sent = Ros1Goal(self, goal.id, on_feedback)
        if sent.text in self._goals:
            raise GoalRejected(self.action)
        try:
            body = self._types.of_goal.to_ros1(goal.payload)
        except DecodeError as error:
            raise CallFailed(self.action, str(error)) from None
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        if not await self.wait_available(timeout_s):
            self._check()
            raise NotServed(self.action, "action")
        self._goals[sent.text] = sent
        self._publishers[1].publish_raw(goal_message(GoalId(sent.text, time.time_ns()), body))
        try:
            await settled(sent.accepted, max(deadline - loop.time(), 0.001))
            if not sent.accepted.done():
                raise CallTimeout(self.action, timeout_s, "action")
            sent.accepted.result()
        except BaseException as error:
            self._goals.pop(sent.text, None)
            if isinstance(error, (CallTimeout, asyncio.CancelledError)) and not self.closed:
                self._publishers[0].publish_raw(cancel_message(sent.text))
            raise
        return sent

    async def cancel(self, goal: Ros1Goal, timeout_s: float) -> bool:
        """Ask for the end of a goal. Raises ``CallTimeout``."""
        if goal.outcome.done():
            return False
        self._check()
        loop = asyncio.get_running_loop()
        before, began = goal.heard, loop.time()
        self._publishers[0].publish_raw(cancel_message(goal.text))
        try:
            async with aio.timeout(timeout_s):
                while not goal.code.cancelled:
                    if goal.outcome.done() or goal.code.final:
                        return False
                    if loop.time() - began > _REFUSED_S and goal.heard > before + 1:
                        return False
                    goal.news.clear()
                    await goal.news.wait()
        except TimeoutError:
            raise CallTimeout(self.action, timeout_s, "action") from None
        return True

    def _finish(self, goal: Ros1Goal, outcome: Outcome) -> None:
        goal.finish(outcome)
        self._goals.pop(goal.text, None)

    # ── what the server tells ──────────────────────────────────────────────────────────────────────────────────

    def _take_status(self, raw: bytes, server: str) -> None:
        statuses = {status.goal.text: status for status in read_statuses(raw)}
        for text, goal in list(self._goals.items()):
            status = statuses.get(text)
            if status is None:
                if goal.server == server:
                    self._expect(goal, Code.LOST, "the action server does not know this goal any more")
                continue
            goal.server = server
            goal.heard += 1
            self._advance(goal, status.code)
            if goal.code.final:
                self._expect(goal, goal.code, status.text)

    def _advance(self, goal: Ros1Goal, code: Code) -> None:
        goal.code = code
        if code is Code.REJECTED:
            goal.refuse(GoalRejected(self.action))
        elif code not in (Code.PENDING, Code.RECALLING) and not goal.accepted.done():
            goal.accepted.set_result(None)
        goal.news.set()

    def _expect(self, goal: Ros1Goal, code: Code, text: str) -> None:
        """Wait a while for the result of a goal that has ended: it is on its way, or lost."""
        if goal.expiry is None:
            outcome = Outcome(code.outcome, None, text)
            goal.expiry = asyncio.get_running_loop().call_later(_RESULT_S, self._finish, goal, outcome)

    def _take_result(self, raw: bytes, server: str) -> None:
        status, body = read_report(raw)
        goal = self._goals.get(status.goal.text)
        if goal is None:
            return
        payload: bytes | None = None
        text = status.text
        try:
            payload = self._types.of_result.from_ros1(body)
        except DecodeError as error:
            self._lost("result", Undelivered.DECODE)
            text = str(error)
        self._advance(goal, status.code)
        outcome = Outcome(status.code.outcome, payload, text)
        if goal.on_feedback is None:
            self._finish(goal, outcome)
            return
        if goal.expiry is not None:
            goal.expiry.cancel()
        goal.expiry = asyncio.get_running_loop().call_later(_SETTLE_S, self._finish, goal, outcome)

    def _take_feedback(self, raw: bytes, server: str) -> None:
        status, body = read_report(raw)
        goal = self._goals.get(status.goal.text)
        if goal is None or goal.on_feedback is None:
            return
        payload = self._types.of_feedback.from_ros1(body)
        try:
            goal.on_feedback(payload)
        except Exception:  # a callback is somebody else's code
            self._lost("feedback", Undelivered.CALLBACK)
            failed(log, "%s: a callback for feedback of %s failed", self._node.graph.name, self.action)

    def _lost(self, topic: str, why: Undelivered) -> None:
        self._node.graph.drops[f"{self.action}/{topic}", why] += 1
