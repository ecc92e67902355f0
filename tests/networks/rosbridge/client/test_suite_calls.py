"""Services and actions of the ``rosbridge`` graph through a genuine rosbridge server, with genuine nodes behind it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from ropeway.errors import CallError, CallTimeout, GraphUnavailable, NotServed, ProviderLost
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.rosbridge.client import RosbridgeGraph
from tests.networks.ros2.test_calls import PROGRAM
from tests.networks.rosbridge.client.test_suite import DOMAIN, Suite
from tests.support.actions import FIBONACCI, order, sequence
from tests.support.ros2 import CYCLONE, Peer, start_peer
from tests.support.services import ADD, Gate, add, addends, total
from tests.support.until import PATIENCE_S

pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]


class Calls(Suite):
    """A genuine server, and genuine nodes beside it."""

    async def node(self, *words: object) -> Peer:
        """A node, once it is there."""
        env = {"RMW_IMPLEMENTATION": CYCLONE, "ROS_DOMAIN_ID": str(DOMAIN)}
        peer = await start_peer(self.stack, PROGRAM, *words, env=env)
        await peer.wait(lambda: "ready" in peer.told)
        return peer


@pytest.fixture
async def suite(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Calls]:
    """A running server; everything is ended."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)  # genuine nodes have no tag
    monkeypatch.setenv("RMW_IMPLEMENTATION", CYCLONE)
    async with AsyncExitStack() as stack:
        suite = Calls(stack)
        stack.push_async_callback(suite.stop)
        await suite.start()
        yield suite


async def called(graph: RosbridgeGraph, name: str, a: int = 40) -> bytes:
    """The answer of a service, once the server has discovered it."""
    client = await graph.create_client(name, ADD)
    end = time.monotonic() + 30
    while True:
        try:
            return await client.call(Request(addends(a, 2)), 10)
        except CallError:
            if time.monotonic() > end:
                raise


async def test_calls(suite: Calls) -> None:
    """A genuine service answers, one call or fifty; one that is not there does not exist."""
    await suite.node("serve", "/sum")
    graph = await suite.client()
    assert await called(graph, "/sum") == total(42)
    client = await graph.create_client("/sum", ADD)
    calls = [client.call(Request(addends(i, 1)), 30) for i in range(50)]
    assert await asyncio.gather(*calls) == [total(i + 1) for i in range(50)]
    nobody = await graph.create_client("/nobody", ADD)
    with pytest.raises((NotServed, CallTimeout)):
        await nobody.call(Request(addends(1)), 10)
    await suite.stop()
    with pytest.raises(GraphUnavailable, match="the link is down"):
        await client.call(Request(addends(1)), 1)


async def test_server_dies_in_mid_call(suite: Calls) -> None:
    """A call under way fails at once when the server dies."""
    await suite.node("serve", "/sum", "--delay", 2)
    graph = await suite.client()
    assert await called(graph, "/sum") == total(42)
    client = await graph.create_client("/sum", ADD)
    call = asyncio.create_task(client.call(Request(addends(1)), 60))
    await asyncio.sleep(0.5)
    await suite.stop()
    with pytest.raises(ProviderLost):
        await call


async def test_serves(suite: Calls) -> None:
    """Genuine nodes call a service of ours through the server, and get their answers."""
    graph = await suite.client()
    service = await graph.create_service("/sum", ADD, add)
    caller = await suite.node("call", "/sum", "--count", 20)
    await caller.wait(lambda: "right" in caller.told)
    assert caller.told["right"] == 20
    burst = await suite.node("call", "/sum", "--count", 8, "--burst")
    await burst.wait(lambda: "right" in burst.told)
    assert burst.told["right"] == 8
    await service.close()
    gate = Gate()
    await graph.create_service("/sum", ADD, gate)
    gate.open.set()
    again = await suite.node("call", "/sum", "--count", 1)
    await again.wait(lambda: "right" in again.told)
    assert again.told["right"] == 1
    assert len(gate.seen) == 1


async def test_uses_an_action(suite: Calls) -> None:
    """A genuine action carries out goals with feedback; one that is cancelled ends."""
    await suite.node("act", "/fib", "--delay", 0.05)
    graph = await suite.client()
    client = await graph.create_action_client("/fib", FIBONACCI)
    end = time.monotonic() + 30
    outcome = Outcome(GoalStatus.UNKNOWN)
    fed: list[bytes] = []
    while outcome.status is not GoalStatus.SUCCEEDED and time.monotonic() < end:  # the server has to discover it
        goal = await client.send_goal(Goal(order(6)), on_feedback=fed.append)
        outcome = await goal.result(PATIENCE_S)
    assert outcome == Outcome(GoalStatus.SUCCEEDED, sequence(0, 1, 1, 2, 3, 5))
    assert fed == [sequence(*(0, 1, 1, 2, 3, 5)[:size]) for size in (3, 4, 5, 6)]
    long = await client.send_goal(Goal(order(40)), on_feedback=fed.append)
    while len(fed) < 6:
        await asyncio.sleep(0.01)
    assert await long.cancel()
    outcome = await long.result(PATIENCE_S)
    assert outcome.status.final  # 2.1.0 hears of the cancel when the goal has ended


async def test_serves_an_action(suite: Calls) -> None:
    """A genuine client's goals are carried out here, with feedback, and end with the status that we give."""

    async def execute(goal: ServerGoal) -> Outcome:
        for number in range(1, 4):
            goal.feedback(sequence(*range(number)))
            await asyncio.sleep(0.1)
        status = GoalStatus.SUCCEEDED if goal.payload == order(6) else GoalStatus.ABORTED
        return Outcome(status, sequence(1, 2, 3))

    graph = await suite.client()
    await graph.create_action_server("/fib", FIBONACCI, ActionHandlers(execute))
    sender = await suite.node("goal", "/fib", "--order", 6)
    await sender.wait(lambda: "status" in sender.told)
    assert (sender.told["status"], sender.told["sequence"]) == (4, [1, 2, 3])
    assert sender.told["heard"] == [1, 2, 3]
    aborted = await suite.node("goal", "/fib", "--order", 7)
    await aborted.wait(lambda: "status" in aborted.told)
    assert aborted.told["status"] == 6


async def test_cancelled_by_a_node(suite: Calls) -> None:
    """A genuine client's cancel reaches the goal that is carried out here."""

    async def execute(goal: ServerGoal) -> Outcome:
        while not goal.cancelled.is_set():
            goal.feedback(sequence(1))
            await asyncio.sleep(0.1)
        return Outcome(GoalStatus.CANCELED, sequence(9))

    graph = await suite.client()
    await graph.create_action_server("/fib", FIBONACCI, ActionHandlers(execute))
    sender = await suite.node("goal", "/fib", "--cancel")
    await sender.wait(lambda: "status" in sender.told)
    assert sender.told["cancelling"] == 1
    assert sender.told["status"] == 5
