"""An action client made of three services and a topic: the status topic says nothing that the services do not."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Final

from ropeway.errors import (
    CallError,
    CallFailed,
    CallTimeout,
    DecodeError,
    GoalRejected,
    GraphError,
    GraphUnavailable,
    NotServed,
    ProviderLost,
)
from ropeway.graph.actions.parts import (
    CANCEL_TYPE,
    ERROR_NONE,
    FEEDBACK_QOS,
    ActionParts,
)
from ropeway.graph.base import NO_HINTS, Delivery, Graph, GraphEvent, Sample, Subscription, Undelivered, look_up
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Client, Goal, GoalStatus, Outcome, Request
from ropeway.tasks import Chores, Supervised, background, describe, end, settled, tell_failure
from ropeway.types import TypeRegistry

__all__ = ["ComposedActionClient", "ComposedGoal"]

log = logging.getLogger("ropeway.graph")

_RESULT_S: Final = 86_400.0  # a goal may take long; a call has to end some day
_EARLY_FEEDBACK: Final = 1024  # kept until the goal is known to be accepted
_LATE_S: Final = 10.0  # a goal that is accepted so long after its sender has left is cancelled
_GRACE_S: Final = 0.25  # a result that is on its way when its server leaves may arrive so much later
_GONE: Final = "the action server has gone"


class ComposedGoal:
    """A goal that was sent; its users get it when it is accepted."""

    def __init__(self, client: ComposedActionClient, id: bytes, on_feedback: Callable[[bytes], None] | None) -> None:
        self.id = id
        self.abandoned = False
        self.follower: asyncio.Task[None] | None = None
        self.outcome: asyncio.Future[Outcome] = asyncio.get_running_loop().create_future()
        self._client = client
        self._on_feedback = on_feedback
        self._early: deque[bytes] | None = deque()

    def feed(self, payload: bytes) -> None:
        """Hand a feedback to the user, once the user knows that the goal is accepted."""
        if self._early is None:
            self._client.tell(self._on_feedback, payload)
            return
        self._early.append(payload)
        if len(self._early) > _EARLY_FEEDBACK:
            self._early.popleft()
            self._client.lost(Undelivered.BACKLOG)

    def release(self) -> None:
        """Hand over the feedback that came before the acceptance."""
        early, self._early = self._early or (), None
        for payload in early:
            self._client.tell(self._on_feedback, payload)

    def finish(self, outcome: Outcome) -> None:
        """End the goal; only the first end counts."""
        if not self.outcome.done():
            self.outcome.set_result(outcome)

    async def result(self, timeout_s: float | None = None) -> Outcome:
        """See ``ClientGoal``."""
        if not await settled(self.outcome, timeout_s):
            raise CallTimeout(self._client.action, timeout_s or 0.0, "action")
        return self.outcome.result()

    async def cancel(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> bool:
        """See ``ClientGoal``."""
        return not self.outcome.done() and await self._client.cancel(self.id, timeout_s)


class ComposedActionClient:
    """An action used on a graph through the graph's own services and topics; ``open`` begins."""

    def __init__(
        self, graph: Graph, action: str, type: str, registry: TypeRegistry, *, delivery: Delivery = NO_HINTS
    ) -> None:
        self._delivery = delivery
        self._parts = ActionParts(action, type, registry)
        self.action, self.type = self._parts.action, self._parts.type
        self.closed = False
        self.on_closed: Callable[[], None] | None = None
        self._graph = graph
        self._goals: dict[bytes, ComposedGoal] = {}
        self._sending: set[asyncio.Task[None]] = set()
        self._late = Chores()  # the ends of goals whose sender has left
        self._watch: Supervised | None = None
        self._feedback: Subscription | None = None
        self._clients: list[Client] = []
        self._send: Client
        self._cancel: Client
        self._result: Client

    async def open(self) -> None:
        """Use the action. Topics come first, so that a server that answers has seen who listens for feedback."""
        parts, graph = self._parts, self._graph
        name = f"watch action {self.action}"
        self._watch = Supervised(lambda: self._follow_server(graph.changes()), name).start()
        try:
            self._feedback = await graph.create_subscription(
                parts.feedback, parts.feedback_type, FEEDBACK_QOS, self._take_feedback, delivery=self._delivery
            )
            self._cancel = await self._client(parts.cancel_goal, CANCEL_TYPE)
            self._result = await self._client(parts.get_result, parts.get_result_type)
            self._send = await self._client(parts.send_goal, parts.send_goal_type)
        except BaseException:
            await self.close()
            raise

    async def _client(self, service: str, type: str) -> Client:
        client = await self._graph.create_client(service, type, delivery=self._delivery)
        self._clients.append(client)
        return client

    async def close(self) -> None:
        """See ``ActionClient``."""
        if self.closed:
            return
        self.closed = True
        goals = list(self._goals.values())
        self._abort(goals, "the action client was closed")
        await end(self._watch, *self._sending, *(goal.follower for goal in goals))
        await self._late.close()
        self._goals.clear()
        for client in self._clients:
            await client.close()
        if self._feedback is not None:
            await self._feedback.close()
        if self.on_closed is not None:
            self.on_closed()

    @property
    def available(self) -> bool | None:
        """Whether all three services of the action are there."""
        states = [client.available for client in self._clients]
        return None if None in states else all(states)

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``ActionClient``."""
        self._check()
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        for client in self._clients:
            if not await client.wait_available(max(deadline - loop.time(), 0.0)):
                return False
        return True

    async def send_goal(
        self,
        goal: Goal,
        *,
        on_feedback: Callable[[bytes], None] | None = None,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> ComposedGoal:
        """See ``ActionClient``. A goal that is accepted after its sender stopped waiting is cancelled."""
        self._check()
        if goal.id in self._goals:
            raise GoalRejected(self.action)
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        sent = self._goals[goal.id] = ComposedGoal(self, goal.id, on_feedback)
        sending: asyncio.Task[None] | None = None
        try:
            if not self.available:
                if not await self.wait_available(timeout_s):
                    raise NotServed(self.action, "action")
                self._check()
            left_s = max(deadline - loop.time(), 0.001)
            sending = asyncio.create_task(self._negotiate(goal, sent, left_s), name=f"goal for {self.action}")
            self._sending.add(sending)
            sending.add_done_callback(self._sending.discard)
            await settled(sending, left_s)
        except asyncio.CancelledError:
            if sending is not None and sent.follower is not None:
                self._late.start(self._give_up(sent), f"end of a goal of {self.action}")
            raise
        finally:
            if sending is None:
                self._goals.pop(goal.id, None)
            elif not sending.done():
                sent.abandoned = True
                sending.add_done_callback(tell_failure)
        if not sending.done():
            raise CallTimeout(self.action, timeout_s, "action")
        if sending.cancelled():
            raise GraphUnavailable(self._graph.name, f"the client of {self.action} was closed in mid-call")
        sending.result()
        loop.call_soon(sent.release)  # when the sender knows its goal
        return sent

    async def _negotiate(self, goal: Goal, sent: ComposedGoal, timeout_s: float) -> None:
        """Send the goal and see whether it is accepted; outlives a sender that has stopped waiting."""
        payload = self._parts.join(goal.id, goal.payload)
        request = Request(payload, via=goal.via, caller=goal.caller, timeout_s=timeout_s)
        try:
            response = await self._send.call(request, timeout_s + _LATE_S)
            if not self._parts.is_accepted(response):
                raise GoalRejected(self.action)
        except BaseException as error:  # also a cancellation: the error gets the name of the action
            self._goals.pop(goal.id, None)
            if sent.abandoned and isinstance(error, (GraphError, DecodeError)):
                return
            raise self._named(error, timeout_s) from None
        if not sent.abandoned:
            sent.follower = background(self._follow(sent), f"result of {self.action}")
            return
        await self._give_up(sent)

    async def _give_up(self, sent: ComposedGoal) -> None:
        """Cancel a goal whose sender has left."""
        self._goals.pop(sent.id, None)
        await end(sent.follower)
        log.warning("%s: a goal was accepted after its sender had left; it is cancelled", self.action)
        with contextlib.suppress(CallError):
            await self.cancel(sent.id, DEFAULT_TIMEOUT_S)

    async def _follow(self, sent: ComposedGoal) -> None:
        """Ask for the result, once, and wait for it."""
        try:
            response = await self._result.call(Request(self._parts.result_request(sent.id)), _RESULT_S)
            status, payload = self._parts.outcome(response)
        except (GraphError, DecodeError) as error:
            sent.finish(Outcome(GoalStatus.ABORTED, None, str(self._named(error, _RESULT_S))))
        except Exception as error:  # of a graph: nobody shall wait for a result that does not come
            log.exception("%s: a goal of %s has no result", self._graph.name, self.action)
            sent.finish(Outcome(GoalStatus.ABORTED, None, describe(error)))
        else:
            if GoalStatus.SUCCEEDED <= status <= GoalStatus.ABORTED:
                sent.finish(Outcome(GoalStatus(status), payload))
            else:
                text = f"the server of {self.action} does not know this goal any more"
                sent.finish(Outcome(GoalStatus.ABORTED, None, text))
        finally:
            self._goals.pop(sent.id, None)

    async def cancel(self, id: bytes, timeout_s: float) -> bool:
        """Ask for the end of a goal. Raises ``CallError``."""
        self._check()
        try:
            response = await self._cancel.call(Request(self._parts.cancel_request(id), timeout_s=timeout_s), timeout_s)
            code, ending = self._parts.cancel_answer(response)
        except (CallError, DecodeError) as error:
            raise self._named(error, timeout_s) from None
        return code == ERROR_NONE and id in ending

    def _named(self, error: BaseException, timeout_s: float) -> BaseException:
        """Turn the failure of one of the services into one of the action."""
        match error:
            case NotServed():
                return NotServed(self.action, "action")
            case CallTimeout():
                return CallTimeout(self.action, timeout_s, "action")
            case ProviderLost():
                return ProviderLost(self.action, error.reason)
            case CallFailed() | DecodeError():
                return CallFailed(self.action, str(error))
        return error

    # ── the server ─────────────────────────────────────────────────────────────────────────────────────────────

    async def _follow_server(self, changes: AsyncIterator[GraphEvent]) -> None:
        """Abort what is under way when the last server of the action leaves."""
        async for event in changes:
            if event.discovered or event.kind != "action" or event.name != self.action or self._served():
                continue
            left = [goal for goal in self._goals.values() if goal.follower is not None]
            if not left:
                continue
            await asyncio.wait({goal.outcome for goal in left}, timeout=_GRACE_S)
            self._abort(left, _GONE)
        self._abort(list(self._goals.values()), f"{self._graph.name} was closed")

    def _served(self) -> bool:
        info = look_up(self._graph, "action", self.action)
        return info is not None and any(not server.local for server in info.servers)

    def _abort(self, goals: list[ComposedGoal], text: str) -> None:
        for goal in goals:
            goal.finish(Outcome(GoalStatus.ABORTED, None, text))
            if goal.follower is not None:
                goal.follower.cancel()

    # ── feedback ───────────────────────────────────────────────────────────────────────────────────────────────

    def _take_feedback(self, batch: Sequence[Sample]) -> None:
        for sample in batch:
            try:
                id, payload = self._parts.split(sample.payload)
            except DecodeError as error:
                log.warning("%s: a feedback is unreadable: %s", self.action, error)
                self.lost(Undelivered.DECODE)
                continue
            goal = self._goals.get(id)
            if goal is not None:
                goal.feed(payload)

    def tell(self, callback: Callable[[bytes], None] | None, payload: bytes) -> None:
        """Call a user's callback."""
        if callback is None:
            return
        try:
            callback(payload)
        except Exception:  # a callback is somebody else's code
            self.lost(Undelivered.CALLBACK)
            log.exception("%s: a callback for feedback of %s failed", self._graph.name, self.action)

    def lost(self, why: Undelivered) -> None:
        """Count a feedback that did not reach its user."""
        self._graph.drops[self._parts.feedback, why] += 1

    def _check(self) -> None:
        if self.closed:
            raise GraphUnavailable(self._graph.name, f"the client of {self.action} is closed")
