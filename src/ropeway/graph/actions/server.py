"""An action server made of three services and two topics."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable
from itertools import chain, islice
from typing import Final

from ropeway import aio
from ropeway.errors import DecodeError, RopewayError
from ropeway.graph.actions.parts import (
    CANCEL_TYPE,
    ERROR_GOAL_TERMINATED,
    ERROR_NONE,
    ERROR_REJECTED,
    ERROR_UNKNOWN_GOAL_ID,
    FEEDBACK_QOS,
    NO_GOAL,
    STATUS_QOS,
    STATUS_TYPE,
    ActionParts,
    status_array,
    status_entry,
)
from ropeway.graph.base import NO_HINTS, SEQ_NONE, Delivery, Graph, Publisher, Sample, Undelivered
from ropeway.graph.calls import ActionHandlers, GoalStatus, Outcome, Request, ServerGoal, Service
from ropeway.tasks import background, end
from ropeway.types import TypeRegistry

__all__ = ["ComposedActionServer"]

log = logging.getLogger("ropeway.graph")

_GOALS_LIMIT: Final = 10_000  # under way at a time; more are rejected
_KEPT: Final = 256  # ended goals whose result can still be asked for …
_KEPT_BYTES: Final = 64 << 20  # … with results of so many bytes in total …
_KEPT_S: Final = 900.0  # … for so long, as in ROS 2 up to Iron; later distributions keep them 10 s
_TOLD: Final = 32  # goals that ended last: nodes decode the states of all that are told at each step of one
_EARLY_FEEDBACK: Final = 256  # before a goal is accepted; the oldest goes first
_CLOSE_S: Final = 2.0  # how long closing waits for the answers to those who wait for results
_ASK_S: Final = 1.0  # who wants the result of a goal asks for it so soon after it was accepted


class _Tracked:
    """A goal that was accepted, and how far it is."""

    def __init__(self, goal: ServerGoal, stamp_ns: int) -> None:
        self.goal = goal
        self.stamp_ns = stamp_ns
        self.response = b""  # with the result, once it has ended
        self.waiting: set[asyncio.Future[None]] = set()  # those who have asked for the result
        self.work: asyncio.Task[None] | None = None
        self.taken_s = asyncio.get_running_loop().time()
        self.asked = asyncio.Event()  # somebody asks for its result
        self.ended_s = 0.0
        self.become(GoalStatus.ACCEPTED)

    def become(self, status: GoalStatus) -> None:
        """Change the status, and what is told of it."""
        self.status = status
        self.told = status_entry(self.goal.id, self.stamp_ns, status)


class ComposedActionServer:
    """An action served on a graph through the graph's own services and topics.

    ``open`` begins. The result of a goal that has ended can be asked for until 256 others have ended, or for 15
    minutes. A goal id that is known is rejected.
    """

    def __init__(
        self,
        graph: Graph,
        action: str,
        type: str,
        handlers: ActionHandlers,
        registry: TypeRegistry,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> None:
        self._delivery = delivery
        self._parts = ActionParts(action, type, registry)
        self.action, self.type = self._parts.action, self._parts.type
        self.closed = False
        self.on_closed: Callable[[], None] | None = None
        self._graph = graph
        self._handlers = handlers
        self._deciding: set[bytes] = set()
        self._goals: dict[bytes, _Tracked] = {}
        self._ended: OrderedDict[bytes, _Tracked] = OrderedDict()
        self._ended_bytes = 0
        self._untold = 0  # goals that have ended since the states were published
        self._expiry: asyncio.TimerHandle | None = None
        self._waiting = 0
        self._all_answered = asyncio.Event()
        self._feedback: Publisher | None = None
        self._status: Publisher | None = None
        self._services: list[Service] = []

    async def open(self) -> None:
        """Serve the action. Topics come first, so that who sees the services can hear about goals already."""
        parts, graph = self._parts, self._graph
        try:
            self._feedback = await graph.create_publisher(
                parts.feedback, parts.feedback_type, FEEDBACK_QOS, delivery=self._delivery
            )
            self._status = await graph.create_publisher(parts.status, STATUS_TYPE, STATUS_QOS, delivery=self._delivery)
            for name, type, handler in (
                (parts.get_result, parts.get_result_type, self._give_result),
                (parts.cancel_goal, CANCEL_TYPE, self._cancel),
                (parts.send_goal, parts.send_goal_type, self._take),
            ):
                self._services.append(await graph.create_service(name, type, handler, delivery=self._delivery))
        except BaseException:
            await self.close()
            raise
        self._publish_status()

    async def close(self) -> None:
        """See ``ActionServer``; who waits for the result of a goal under way gets ABORTED first."""
        if self.closed:
            return
        self.closed = True
        under_way = list(self._goals.values())
        for tracked in under_way:
            self._finish(tracked, Outcome(GoalStatus.ABORTED, None, "the action server was closed"))
        self._tell_ends()
        await end(*(tracked.work for tracked in under_way))
        await self._be_asked(under_way)
        if self._waiting:
            self._all_answered.clear()
            try:
                async with aio.timeout(_CLOSE_S):
                    await self._all_answered.wait()
            except TimeoutError:
                log.warning(
                    "%s: %d results could not be delivered before the server closed", self.action, self._waiting
                )
        for service in reversed(self._services):
            await service.close()
        for publisher in (self._feedback, self._status):
            if publisher is not None:
                await publisher.close()
        if self._expiry is not None:
            self._expiry.cancel()
        self._ended.clear()
        if self.on_closed is not None:
            self.on_closed()

    async def _be_asked(self, goals: Iterable[_Tracked]) -> None:
        """Give clients that sent a goal a moment ago the time to ask for its result, so that they are not left without
        an answer.
        """
        loop = asyncio.get_running_loop()
        for tracked in goals:
            if not tracked.asked.is_set() and tracked.taken_s + _ASK_S > loop.time():
                with contextlib.suppress(TimeoutError):
                    async with aio.timeout_at(tracked.taken_s + _ASK_S):
                        await tracked.asked.wait()

    # ── send_goal ──────────────────────────────────────────────────────────────────────────────────────────────

    async def _take(self, request: Request) -> bytes:
        id, payload = self._parts.split(request.payload)
        stamp_ns = time.time_ns()
        early: deque[bytes] = deque(maxlen=_EARLY_FEEDBACK)
        goal = ServerGoal(payload, id, early.append, request.via, request.caller)
        if not await self._accepts(goal):
            return self._parts.accepted(False, stamp_ns)
        tracked = self._goals[id] = _Tracked(goal, stamp_ns)
        goal.feedback = lambda feedback: self._send_feedback(id, feedback)
        for feedback in early:
            goal.feedback(feedback)
        # The task begins once the answer is on its way, and tells the state then.
        tracked.work = background(self._carry_out(tracked), f"goal of {self.action}")
        return self._parts.accepted(True, stamp_ns)

    async def _accepts(self, goal: ServerGoal) -> bool:
        id = goal.id
        if self.closed or id in self._goals or id in self._ended or id in self._deciding:
            return False
        if len(self._goals) + len(self._deciding) >= _GOALS_LIMIT:
            log.warning("%s: a goal is rejected, %d are under way already", self.action, len(self._goals))
            return False
        if self._handlers.accept is None:
            return True
        self._deciding.add(id)
        try:
            return await self._handlers.accept(goal) and not self.closed
        except Exception as error:  # a handler is somebody else's code; its failure rejects this goal
            self._blame("accepting a goal", error)
            return False
        finally:
            self._deciding.discard(id)

    async def _carry_out(self, tracked: _Tracked) -> None:
        if tracked.status is GoalStatus.ACCEPTED:
            tracked.become(GoalStatus.EXECUTING)
            self._publish_status()
        try:
            outcome = await self._handlers.execute(tracked.goal)
        except asyncio.CancelledError:
            self._finish(tracked, Outcome(GoalStatus.ABORTED, None, "it was given up"))
            raise
        except Exception as error:  # a handler is somebody else's code; its failure aborts this goal
            self._blame("carrying out a goal", error)
            outcome = Outcome(GoalStatus.ABORTED, None, str(error))
        self._finish(tracked, outcome)

    def _finish(self, tracked: _Tracked, outcome: Outcome) -> None:
        if tracked.status.final:
            return
        status = outcome.status
        if not status.final:
            log.error("%s: a goal ended with status %s; it is aborted", self.action, status.name)
            status = GoalStatus.ABORTED
        try:
            response = self._parts.result(status, outcome.payload)
        except DecodeError as error:
            log.error("%s: the result of a goal cannot be sent: %s", self.action, error)
            status = GoalStatus.ABORTED
            response = self._parts.result(status, None)
        tracked.become(status)
        tracked.response = response
        for waiting in tracked.waiting:
            if not waiting.done():
                waiting.set_result(None)
        self._goals.pop(tracked.goal.id, None)
        self._keep(tracked)
        self._untold += 1
        if self._untold == 1:  # their results go first: a node takes long for the states
            asyncio.get_running_loop().call_soon(self._tell_ends)

    def _tell_ends(self) -> None:
        if self._untold:
            self._publish_status()

    # ── what is kept of goals that have ended ──────────────────────────────────────────────────────────────────

    def _keep(self, tracked: _Tracked) -> None:
        tracked.ended_s = asyncio.get_running_loop().time()
        self._ended[tracked.goal.id] = tracked
        self._ended_bytes += len(tracked.response)
        while len(self._ended) > _KEPT or (self._ended_bytes > _KEPT_BYTES and len(self._ended) > 1):
            self._drop_oldest()
        self._expire()

    def _drop_oldest(self) -> None:
        _, oldest = self._ended.popitem(last=False)
        self._ended_bytes -= len(oldest.response)

    def _expire(self) -> None:
        loop = asyncio.get_running_loop()
        if self._expiry is not None:
            self._expiry.cancel()
            self._expiry = None
        while self._ended:
            ends_s = next(iter(self._ended.values())).ended_s + _KEPT_S
            if ends_s > loop.time():
                if not self.closed:
                    self._expiry = loop.call_at(ends_s, self._expire)
                return
            self._drop_oldest()

    # ── get_result ─────────────────────────────────────────────────────────────────────────────────────────────

    async def _give_result(self, request: Request) -> bytes:
        id, _ = self._parts.split(request.payload)
        tracked = self._goals.get(id) or self._ended.get(id)
        if tracked is None:
            return self._parts.result(GoalStatus.UNKNOWN, None)
        self._waiting += 1
        tracked.asked.set()
        waiting: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        tracked.waiting.add(waiting)
        try:
            await (asyncio.sleep(0) if tracked.response else waiting)  # what was sent before it comes first
        finally:
            tracked.waiting.discard(waiting)
            self._waiting -= 1
            if not self._waiting:
                self._all_answered.set()
        return tracked.response

    # ── cancel_goal ────────────────────────────────────────────────────────────────────────────────────────────

    async def _cancel(self, request: Request) -> bytes:
        id, until_ns = self._parts.cancel_wish(request.payload)
        if id != NO_GOAL and not until_ns:
            found = self._goals.get(id)
            if found is None:
                code = ERROR_GOAL_TERMINATED if id in self._ended else ERROR_UNKNOWN_GOAL_ID
                return self._parts.cancelling(code, [])
            asked = [found]
        else:
            everything = id == NO_GOAL and not until_ns
            asked = [
                tracked
                for tracked in self._goals.values()
                if everything or tracked.stamp_ns <= until_ns or tracked.goal.id == id
            ]
        ending = [tracked for tracked in asked if await self._agrees(tracked)]
        if any(tracked.status is GoalStatus.CANCELING for tracked in ending):
            self._publish_status()
        code = ERROR_REJECTED if asked and not ending else ERROR_NONE
        return self._parts.cancelling(code, [(tracked.goal.id, tracked.stamp_ns) for tracked in ending])

    async def _agrees(self, tracked: _Tracked) -> bool:
        """Ask the handler whether the goal may be cancelled and return its answer; a goal that agrees is marked."""
        if tracked.status is GoalStatus.CANCELING:
            return True
        if self._handlers.cancel is not None:
            try:
                if not await self._handlers.cancel(tracked.goal):
                    return False
            except Exception as error:  # a handler is somebody else's code; its failure refuses the request
                self._blame("cancelling a goal", error)
                return False
        if tracked.status.final:
            return False
        tracked.become(GoalStatus.CANCELING)
        tracked.goal.cancelled.set()
        return True

    # ── topics ─────────────────────────────────────────────────────────────────────────────────────────────────

    def _send_feedback(self, id: bytes, payload: bytes) -> None:
        if id not in self._goals or self._feedback is None:
            self._graph.drops[self._parts.feedback, Undelivered.CLOSED] += 1
            return
        message = self._parts.join(id, payload)
        self._feedback.publish(Sample(message, self._parts.feedback_type, time.time_ns(), bytes(16), SEQ_NONE))

    def _publish_status(self) -> None:
        if self._status is None:
            return
        ended = islice(self._ended.values(), max(0, len(self._ended) - max(_TOLD, self._untold)), None)
        self._untold = 0
        message = status_array([tracked.told for tracked in chain(ended, self._goals.values())])
        self._status.publish(Sample(message, STATUS_TYPE, time.time_ns(), bytes(16), SEQ_NONE))

    def _blame(self, doing: str, error: Exception) -> None:
        if isinstance(error, RopewayError):
            log.warning("%s: %s failed: %s", self.action, doing, error)
        else:
            log.error("%s: %s failed", self.action, doing, exc_info=error)
