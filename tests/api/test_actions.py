"""Action clients and servers of programs."""

from __future__ import annotations

import asyncio

import pytest

import ropeway
from ropeway import CallTimeout, ExecutingGoal, GoalRejected, GoalStatus, NotServed, TypedMessage, ValueMismatch
from tests.support.until import until

FIBONACCI = "example_interfaces/action/Fibonacci"


async def fibonacci(goal: ExecutingGoal) -> dict[str, list[int]]:
    sequence = [0, 1]
    for _ in range(goal.request["order"]):
        sequence.append(sequence[-1] + sequence[-2])
        goal.feedback({"sequence": sequence})
    return {"sequence": sequence}


@pytest.mark.parametrize("coroutine", [False, True])
async def test_goal(url: str, coroutine: bool) -> None:
    """A goal of one program is carried out by another, with feedback for a function or a coroutine function."""
    found: list[list[int]] = []

    def take(feedback: TypedMessage) -> None:
        found.append(list(feedback["sequence"]))

    async def take_later(feedback: TypedMessage) -> None:
        await asyncio.sleep(0)
        take(feedback)

    async with (
        ropeway.open(url, name="server") as server,
        ropeway.open(url, name="client") as user,
        server.serve_action("fib", "example_interfaces/Fibonacci", fibonacci) as action,
    ):
        assert (action.action, action.type, action.taken_by) == ("/fib", FIBONACCI, "")
        async with user.action_client("/fib", timeout_s=20) as client:
            assert (client.action, client.type) == ("/fib", FIBONACCI)
            await client.wait_available(timeout_s=20)
            assert client.available
            goal = await client.send_goal({"order": 2}, on_feedback=take_later if coroutine else take, timeout_s=20)
            ended = await goal.result(timeout_s=20)
            assert ended.succeeded
            assert ended.result is not None
            assert list(ended.result["sequence"]) == [0, 1, 1, 2]
            await until(lambda: found == [[0, 1, 1], [0, 1, 1, 2]])


async def test_cancel(network: str) -> None:
    """A goal sees that its end is asked for, and says how it ended."""

    async def wait(goal: ExecutingGoal) -> object:
        assert not goal.cancel_requested
        await goal.wait_cancel_requested()
        assert goal.cancel_requested
        return goal.canceled({"sequence": [7]})

    async with (
        ropeway.open(network) as graph,
        graph.serve_action("/wait", FIBONACCI, wait),
        graph.action_client("/wait") as client,
    ):
        goal = await client.send_goal()
        with pytest.raises(CallTimeout):
            await goal.result(timeout_s=0.01)
        assert await goal.cancel()
        ended = await goal.result(timeout_s=10)
        assert ended.status is GoalStatus.CANCELED
        assert not ended.succeeded
        assert ended.result is not None
        assert list(ended.result["sequence"]) == [7]


async def test_ends(network: str) -> None:
    """A goal is aborted by saying so or by an error, succeeds by saying so, and is rejected before it begins."""

    async def execute(goal: ExecutingGoal) -> object:
        order = goal.request["order"]
        if order == 1:
            return goal.abort("stuck")
        if order == 2:
            raise ValueError("lost")
        return goal.succeed({"sequence": [order]})

    def accept(request: TypedMessage) -> bool:
        return bool(request["order"] < 10)

    async with ropeway.open(network) as graph:
        async with (
            graph.serve_action("/do", FIBONACCI, execute, accept=accept),
            graph.action_client("/do") as client,
        ):
            ends = [await (await client.send_goal({"order": n})).result(timeout_s=10) for n in (1, 2, 3)]
            assert [end.status for end in ends] == [GoalStatus.ABORTED, GoalStatus.ABORTED, GoalStatus.SUCCEEDED]
            assert ends[0].text == "stuck"
            assert "lost" in ends[1].text
            with pytest.raises(GoalRejected):
                await client.send_goal({"order": 10}, on_feedback=print)
            with pytest.raises(ValueMismatch):
                await client.send_goal({"order": "x"})
        async with graph.action_client("/do", FIBONACCI) as client:
            with pytest.raises(NotServed):
                await client.send_goal({"order": 1}, timeout_s=0.05)


async def test_close_ends_goals(network: str) -> None:
    """Goals under way are aborted when their server is closed."""

    async def never(goal: ExecutingGoal) -> None:
        await asyncio.Event().wait()

    async with ropeway.open(network) as graph:
        server = await graph.serve_action("/wait", FIBONACCI, never)
        async with graph.action_client("/wait") as client:
            goal = await client.send_goal(on_feedback=lambda _: None)
            await server.close()
            ended = await goal.result(timeout_s=10)
            assert (ended.status, ended.result) == (GoalStatus.ABORTED, None)
