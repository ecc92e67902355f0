"""Actions among genuine ROS 2 nodes over DDS; skipped where rclpy is not there."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway.errors import GoalRejected
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, ServerGoal
from ropeway.networks.dds import DdsGraph
from ropeway.types import TypeRegistry
from tests.support.actions import FIBONACCI, order, sequence
from tests.support.ros2 import CYCLONE, need_rclpy, start_peer
from tests.support.until import PATIENCE_S, until

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]
need_rclpy()

PROGRAM = Path(__file__).with_name("ros2_peer.py")
DOMAIN = 130 + os.getpid() % 20

Said = list[dict[str, Any]]
Start = Callable[..., Awaitable[Said]]


@pytest.fixture(autouse=True)
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything stays on this machine."""
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    monkeypatch.setenv("RMW_IMPLEMENTATION", CYCLONE)


@pytest.fixture
async def graph(here: None, stack: AsyncExitStack) -> DdsGraph:
    """Our graph."""
    graph = DdsGraph(DOMAIN, name="ours", registry=TypeRegistry())
    await graph.open()
    stack.push_async_callback(graph.close)
    return graph


@pytest.fixture
def start(here: None, stack: AsyncExitStack) -> Start:
    """Starts a genuine node; gives what it says."""

    async def start(*words: str) -> Said:
        return (await start_peer(stack, PROGRAM, *words, env={})).said

    return start


async def count(goal: ServerGoal) -> Outcome:
    """As the genuine server."""
    number = int.from_bytes(goal.payload[4:8], "little", signed=True)
    for step in range(max(number, 1)):
        goal.feedback(sequence(*range(step + 1)))
    if number < 0:
        await goal.cancelled.wait()
        return Outcome(GoalStatus.CANCELED, sequence(number))
    return Outcome(GoalStatus.SUCCEEDED, sequence(number))


async def unless_seven(goal: ServerGoal) -> bool:
    """As the genuine server."""
    return goal.payload != order(7)


async def test_uses_a_genuine_server(graph: DdsGraph, start: Start) -> None:
    """Goals at a genuine server are accepted, followed, cancelled and rejected."""
    said = await start("serve", "/genuine")
    client = await graph.create_action_client("/genuine", FIBONACCI)
    await until(lambda: said)
    assert await client.wait_available(PATIENCE_S)
    assert graph.actions()["/genuine"].type == FIBONACCI
    got: list[bytes] = []
    sent = await client.send_goal(Goal(order(4)), on_feedback=got.append, timeout_s=20)
    assert await sent.result(PATIENCE_S) == Outcome(GoalStatus.SUCCEEDED, sequence(4))
    await until(lambda: len(got) == 4)
    assert got == [sequence(*range(step + 1)) for step in range(4)]
    assert not await sent.cancel()
    sent = await client.send_goal(Goal(order(-2)), timeout_s=20)
    assert await sent.cancel()
    assert await sent.result(PATIENCE_S) == Outcome(GoalStatus.CANCELED, sequence(-2))
    with pytest.raises(GoalRejected):
        await client.send_goal(Goal(order(7)), timeout_s=20)


async def test_many_goals_at_a_genuine_server(graph: DdsGraph, start: Start) -> None:
    """Many goals at a time at a genuine server get each their own result."""
    await start("serve", "/genuine")
    client = await graph.create_action_client("/genuine", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    sent = await asyncio.gather(*(client.send_goal(Goal(order(n)), timeout_s=20) for n in range(8, 28)))
    outcomes = await asyncio.gather(*(goal.result(PATIENCE_S) for goal in sent))
    assert [outcome.payload for outcome in outcomes] == [sequence(n) for n in range(8, 28)]


@pytest.mark.parametrize(
    ("words", "last"),
    [
        (("3",), {"status": 4, "sequence": [3], "first": [[0]]}),
        (("-3", "--cancel"), {"status": 5, "sequence": [-3], "first": [[0]]}),
        (("7",), {"accepted": False}),
    ],
)
async def test_serves_a_genuine_client(graph: DdsGraph, start: Start, words: tuple[str, ...], last: Any) -> None:
    """A genuine client has its goals accepted, cancelled and rejected by our server, and hears feedback."""
    await graph.create_action_server("/ours", FIBONACCI, ActionHandlers(count, unless_seven))
    said = await start("use", "/ours", *words)
    await until(lambda: said[-1:] == [last])
    if "--cancel" in words:
        assert {"cancelling": 1, "code": 0} in said


async def test_leaves_a_genuine_client(graph: DdsGraph, start: Start) -> None:
    """A genuine client gets ABORTED when our server closes."""
    server = await graph.create_action_server("/ours", FIBONACCI, ActionHandlers(count))
    said = await start("use", "/ours", "-1")
    await until(lambda: {"accepted": True} in said)
    await server.close()
    await until(lambda: said[-1].get("status") == 6)
