"""Finding out the type of a name."""

from __future__ import annotations

import asyncio

import pytest

import ropeway
from ropeway import GraphUnavailable, TypeConflict, WaitTimeout


async def test_of_every_kind(url: str) -> None:
    """The types of topics, services and actions that another program has are found out."""

    async def execute(goal: ropeway.ExecutingGoal) -> None:
        return None

    async with (
        ropeway.open(url, name="one") as one,
        ropeway.open(url, name="two") as two,
        one.publisher("/topic", "std_msgs/Bool"),
        one.serve("/service", "std_srvs/Trigger", lambda request: None),
        one.serve_action("/action", "example_interfaces/Fibonacci", execute),
        two.subscribe("/topic", timeout_s=20) as topic,
        two.client("/service", timeout_s=20) as service,
        two.action_client("/action", timeout_s=20) as action,
    ):
        assert topic.type == "std_msgs/msg/Bool"
        assert service.type == "std_srvs/srv/Trigger"
        assert action.type == "example_interfaces/action/Fibonacci"


async def test_several_types(network: str) -> None:
    """A topic with two types has none that could be taken, and the error names both."""
    async with (
        ropeway.open(network) as one,
        ropeway.open(network) as two,
        one.publisher("/a", "std_msgs/Bool"),
        two.publisher("/a", "std_msgs/String"),
    ):
        with pytest.raises(TypeConflict, match="established with type std_msgs/msg/Bool, not std_msgs/msg/String"):
            await two.subscribe("/a")


async def test_who_waits_is_let_go(network: str) -> None:
    """Waiting for a type ends with its time, when it is cancelled, and when the graph is closed."""
    graph = await ropeway.open(network)
    with pytest.raises(WaitTimeout, match="no server of /a"):
        await graph.client("/a", timeout_s=0.01)
    cancelled = asyncio.ensure_future(graph.subscribe("/a", timeout_s=None))
    closed = asyncio.ensure_future(graph.subscribe("/b", timeout_s=None))
    await asyncio.sleep(0)
    cancelled.cancel()
    with pytest.raises(asyncio.CancelledError):
        await cancelled
    await graph.close()
    with pytest.raises(GraphUnavailable, match="it was closed while /b was waited for"):
        await closed
