"""An action client made of services and topics."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest

from ropeway.errors import CallFailed, CallTimeout, GoalRejected, GraphUnavailable, NotServed, ProviderLost
from ropeway.graph.actions import client as module
from ropeway.graph.base import SEQ_NONE, Sample, Undelivered
from ropeway.graph.calls import Goal, GoalStatus, Outcome, Request, ServerGoal, new_id
from ropeway.networks.memory.calls import MemoryClient
from tests.support.actions import order, sequence
from tests.support.until import PATIENCE_S, until

from .conftest import Scene

pytestmark = pytest.mark.jumping


class ByHand:
    """The services and topics of an action, without a server; what it answers is the test's choice."""

    def __init__(self, scene: Scene) -> None:
        self.parts, self.graph = scene.parts, scene.far
        self.accept = self.parts.accepted(True, 0)
        self.result: Any = self.parts.result(GoalStatus.SUCCEEDED, sequence(1))
        self.cancels: list[bytes] = []
        self.cancelling = b""
        self.feedback_before: list[bytes] = []
        self.asked = 0

    async def open(self) -> ByHand:
        parts = self.parts
        self._feedback = await self.graph.create_publisher(parts.feedback, parts.feedback_type)
        await self.graph.create_service(parts.get_result, parts.get_result_type, self._give)
        await self.graph.create_service(parts.cancel_goal, "action_msgs/srv/CancelGoal", self._cancel)
        self.front = await self.graph.create_service(parts.send_goal, parts.send_goal_type, self._take)
        return self

    def feed(self, id: bytes, payload: bytes) -> None:
        self.raw(self.parts.join(id, payload))

    def raw(self, message: bytes) -> None:
        self._feedback.publish(Sample(message, self.parts.feedback_type, time.time_ns(), bytes(16), SEQ_NONE))

    async def _take(self, request: Request) -> bytes:
        id, _ = self.parts.split(request.payload)
        for payload in self.feedback_before:
            self.feed(id, payload)
        await asyncio.sleep(0.05)
        return self.accept

    async def _give(self, request: Request) -> bytes:
        self.asked += 1
        if isinstance(self.result, asyncio.Event):
            await self.result.wait()
        if isinstance(self.result, Exception):
            raise self.result
        return bytes(self.result)

    async def _cancel(self, request: Request) -> bytes:
        id, _ = self.parts.cancel_wish(request.payload)
        self.cancels.append(id)
        return self.cancelling or self.parts.cancelling(0, [(id, 0)])


@pytest.fixture
async def by_hand(scene: Scene) -> ByHand:
    """An action whose answers the test chooses."""
    return await ByHand(scene).open()


async def test_early_feedback(scene: Scene, by_hand: ByHand) -> None:
    """Feedback that comes before the acceptance is handed over after it, in order."""
    by_hand.feedback_before = [sequence(i) for i in range(5)]
    by_hand.result = asyncio.Event()
    client = await scene.use()
    got: list[bytes] = []
    sending = asyncio.create_task(client.send_goal(Goal(order(1)), on_feedback=got.append))
    await until(lambda: len(next(iter(client._goals.values()))._early or ()) == 5 if client._goals else False)
    assert got == []
    sent = await sending
    await until(lambda: got)
    assert got == by_hand.feedback_before
    by_hand.feed(sent.id, sequence(9))
    await until(lambda: len(got) == 6)


async def test_early_feedback_is_bounded(scene: Scene, by_hand: ByHand, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of too much feedback before the acceptance the newest is kept, the rest counted."""
    monkeypatch.setattr(module, "_EARLY_FEEDBACK", 2)
    by_hand.feedback_before = [sequence(i) for i in range(5)]
    client = await scene.use()
    got: list[bytes] = []
    await client.send_goal(Goal(order(1)), on_feedback=got.append)
    assert got == []
    await until(lambda: got)
    assert got == [sequence(3), sequence(4)]
    assert scene.near.drops[scene.parts.feedback, Undelivered.BACKLOG] == 3


async def test_foreign_feedback(scene: Scene, by_hand: ByHand) -> None:
    """Feedback of other goals is not handed over, unreadable feedback counted."""
    by_hand.result = asyncio.Event()
    client = await scene.use()
    got: list[bytes] = []
    sent = await client.send_goal(Goal(order(1)), on_feedback=got.append)
    by_hand.feed(new_id(), sequence(1))
    by_hand.raw(b"\0\1\0\0")
    by_hand.feed(sent.id, sequence(2))
    await until(lambda: got)
    assert got == [sequence(2)]
    assert scene.near.drops[scene.parts.feedback, Undelivered.DECODE] == 1


async def test_callback_fails(scene: Scene, by_hand: ByHand, caplog: pytest.LogCaptureFixture) -> None:
    """A callback that raises is logged and counted, and called again for the next feedback."""
    by_hand.result = asyncio.Event()
    client = await scene.use()
    got: list[bytes] = []

    def moody(payload: bytes) -> None:
        got.append(payload)
        raise ZeroDivisionError("moody")

    sent = await client.send_goal(Goal(order(1)), on_feedback=moody)
    by_hand.feed(sent.id, sequence(1))
    by_hand.feed(sent.id, sequence(2))
    await until(lambda: len(got) == 2)
    assert scene.near.drops[scene.parts.feedback, Undelivered.CALLBACK] == 2
    assert "a callback for feedback of /count failed" in caplog.text


async def test_result_is_asked_once(scene: Scene, by_hand: ByHand) -> None:
    """The result is asked for once, however many wait for it."""
    by_hand.result = asyncio.Event()
    client = await scene.use()
    sent = await client.send_goal(Goal(order(1)))
    waiting = [asyncio.create_task(sent.result()) for _ in range(3)]
    await until(lambda: by_hand.asked)
    done, by_hand.result = by_hand.result, scene.parts.result(GoalStatus.SUCCEEDED, sequence(1))
    done.set()
    assert await asyncio.gather(*waiting) == [Outcome(GoalStatus.SUCCEEDED, sequence(1))] * 3
    assert by_hand.asked == 1


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (CallFailed("x", "out of order"), "out of order"),
        (ZeroDivisionError("oops"), "oops"),
        (b"\0\1\0\0", "not a example_interfaces/action/Fibonacci_GetResult_Response"),
    ],
)
async def test_no_result(scene: Scene, by_hand: ByHand, result: object, words: str) -> None:
    """A result that cannot be had aborts the goal, with the reason."""
    by_hand.result = result
    client = await scene.use()
    outcome = await (await client.send_goal(Goal(order(1)))).result(PATIENCE_S)
    assert outcome.status is GoalStatus.ABORTED
    assert outcome.payload is None
    assert words in outcome.text


async def test_forgotten_goal(scene: Scene, by_hand: ByHand) -> None:
    """A goal that its server has forgotten is aborted."""
    by_hand.result = scene.parts.result(GoalStatus.UNKNOWN, None)
    client = await scene.use()
    outcome = await (await client.send_goal(Goal(order(1)))).result(PATIENCE_S)
    assert outcome.status is GoalStatus.ABORTED
    assert "does not know this goal" in outcome.text


async def test_unreadable_acceptance(scene: Scene, by_hand: ByHand) -> None:
    """An answer to a goal that is none fails the goal."""
    by_hand.accept = b"\0\1\0\0"
    client = await scene.use()
    with pytest.raises(CallFailed, match="SendGoal_Response"):
        await client.send_goal(Goal(order(1)))
    assert not client._goals


async def test_unreadable_cancellation(scene: Scene, by_hand: ByHand) -> None:
    """An answer to a cancellation that is none is a ``CallFailed``."""
    by_hand.result = asyncio.Event()
    by_hand.cancelling = b"\0"
    client = await scene.use()
    sent = await client.send_goal(Goal(order(1)))
    with pytest.raises(CallFailed):
        await sent.cancel()


async def test_cancelling_another(scene: Scene, by_hand: ByHand) -> None:
    """A server that agrees to end another goal has not agreed to end this one."""
    by_hand.result = asyncio.Event()
    by_hand.cancelling = scene.parts.cancelling(0, [(new_id(), 0)])
    client = await scene.use()
    assert not await (await client.send_goal(Goal(order(1)))).cancel()


async def test_same_id_twice(scene: Scene, by_hand: ByHand) -> None:
    """A goal that is under way is not sent again."""
    by_hand.result = asyncio.Event()
    client = await scene.use()
    goal = Goal(order(1))
    await client.send_goal(goal)
    with pytest.raises(GoalRejected):
        await client.send_goal(goal)


async def test_sender_leaves(scene: Scene, by_hand: ByHand) -> None:
    """A goal whose sender is cancelled before the answer is cancelled when it is accepted."""
    client = await scene.use()
    goal = Goal(order(1))
    sending = asyncio.create_task(client.send_goal(goal))
    await until(lambda: client._sending)
    sending.cancel()
    with pytest.raises(asyncio.CancelledError):
        await sending
    await until(lambda: by_hand.cancels == [goal.id])
    await until(lambda: not client._sending)
    assert not client._goals


async def test_sender_of_rejected_goal_leaves(scene: Scene, by_hand: ByHand) -> None:
    """A goal whose sender has left may be rejected without a word."""
    by_hand.accept = scene.parts.accepted(False, 0)
    client = await scene.use()
    with pytest.raises(CallTimeout):
        await client.send_goal(Goal(order(1)), timeout_s=0.02)
    await until(lambda: not client._sending)
    assert by_hand.cancels == []


async def test_not_complete(scene: Scene, by_hand: ByHand) -> None:
    """An action is not there as long as one of its services is not."""
    client = await scene.use()
    assert client.available
    await by_hand.front.close()
    assert not client.available
    with pytest.raises(NotServed, match="No action server available"):
        await client.send_goal(Goal(order(1)), timeout_s=0.1)


async def test_server_leaves_before_acceptance(scene: Scene) -> None:
    """A server that leaves before it answered a goal fails the goal."""
    asked = asyncio.Event()

    async def accept(goal: ServerGoal) -> bool:
        asked.set()
        await asyncio.Event().wait()
        return True

    served = await scene.serve(accept=accept)
    client = await scene.use()
    sending = asyncio.create_task(client.send_goal(Goal(order(1)), timeout_s=50))
    await asked.wait()
    await served.close()
    with pytest.raises(ProviderLost, match="/count was not answered"):
        await sending


async def test_close_before_acceptance(scene: Scene, by_hand: ByHand) -> None:
    """A client that closes fails the goals that are not accepted yet."""
    client = await scene.use()
    sending = asyncio.create_task(client.send_goal(Goal(order(1)), timeout_s=50))
    await until(lambda: client._sending)
    await client.close()
    with pytest.raises(GraphUnavailable):
        await sending
    assert not client._goals


async def test_server_vanishes(scene: Scene, by_hand: ByHand, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that is seen no more aborts its goals, also where calls do not notice."""
    call = MemoryClient.call

    async def deaf(client: MemoryClient, request: Request, timeout_s: float = 10) -> bytes:
        if client.service == scene.parts.get_result:
            await asyncio.Event().wait()
        return await call(client, request, timeout_s)

    monkeypatch.setattr(MemoryClient, "call", deaf)
    client = await scene.use()
    sent = await client.send_goal(Goal(order(1)))
    await by_hand.front.close()
    assert await sent.result(PATIENCE_S) == Outcome(GoalStatus.ABORTED, None, "the action server has gone")
    assert not client._goals


async def test_another_server_stays(scene: Scene, by_hand: ByHand) -> None:
    """A goal goes on where one of two servers leaves."""
    by_hand.result = asyncio.Event()
    client = await scene.use()
    sent = await client.send_goal(Goal(order(1)))
    second = await scene.serve()
    await second.close()
    with pytest.raises(CallTimeout):
        await sent.result(0.5)


async def test_graph_closes(scene: Scene, by_hand: ByHand) -> None:
    """A graph that closes aborts the goals of its clients."""
    by_hand.result = asyncio.Event()
    client = await scene.use()
    sent = await client.send_goal(Goal(order(1)))
    await scene.near.close()
    assert (await sent.result(PATIENCE_S)).status is GoalStatus.ABORTED


async def test_failed_open(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """A client that cannot begin leaves nothing behind."""

    async def refuse(*_: object, **__: object) -> None:
        raise CallFailed("/x", "no")

    monkeypatch.setattr(scene.near, "create_client", refuse)
    with pytest.raises(CallFailed):
        await scene.use()
    assert not scene.near.network.subscriptions
