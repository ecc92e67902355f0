"""ropeway.group.actions: goals of a group, and how long they take."""

from __future__ import annotations

import asyncio

import pytest

from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, ServerGoal
from ropeway.group.bound import LatencyBound
from ropeway.group.options import Options
from tests.group.test_graph import FIBONACCI, Robot, robot
from tests.support.until import PATIENCE_S

pytestmark = pytest.mark.jumping

__all__ = ["robot"]

SEQUENCE = b"\0\1\0\0" + bytes(4)


async def serve(robot: Robot, name: str, seconds: float, status: GoalStatus = GoalStatus.SUCCEEDED) -> None:
    async def execute(_: ServerGoal) -> Outcome:
        await asyncio.sleep(seconds)
        return Outcome(status, SEQUENCE)

    await robot.machines[name].graph.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(execute))


async def test_how_long_goals_take(robot: Robot) -> None:
    """The time until a goal has succeeded is in the profile, once, beside the time until it was accepted."""
    group = await robot.start({"edge1": 0.01, "edge2": 0.01})
    for name in robot.machines:
        await serve(robot, name, 2.0)
    client = await group.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(1.0)
    goal = await client.send_goal(Goal(SEQUENCE))
    for _ in range(2):
        assert (await goal.result(10.0)).status is GoalStatus.SUCCEEDED
    row = group.status()["members"]["edge1"]
    assert row["result_s"]["answered"] == 1
    assert row["result_s"]["mean"] == pytest.approx(2.0, abs=0.1)
    assert row["latency_s"]["answered"] == 1
    assert row["latency_s"]["max"] < 0.5


async def test_judged_by_results(robot: Robot) -> None:
    """Where results are judged, the latency of an action is the time until its goal has succeeded, and no other."""
    group = await robot.start(
        {"edge1": 0.01, "edge2": 0.01},
        options=Options(judge_results=True, window_s=60.0),
        bound=LatencyBound.of({"max": 1.0}),
    )
    for name in robot.machines:
        await serve(robot, name, 2.0)
    client = await group.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(1.0)
    await (await client.send_goal(Goal(SEQUENCE))).result(10.0)
    row = group.status()["members"]["edge1"]
    assert (row["latency_s"]["answered"], row["standing"], row["in_flight"]) == (1, "missed", 0)
    assert row["latency_s"]["min"] == pytest.approx(2.0, abs=0.1)


async def test_a_goal_that_fails(robot: Robot) -> None:
    """A goal that does not succeed says nothing of how long one takes."""
    group = await robot.start({"edge1": 0.01})
    await serve(robot, "edge1", 2.0, GoalStatus.ABORTED)
    client = await group.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(1.0)
    assert (await (await client.send_goal(Goal(SEQUENCE))).result(10.0)).status is GoalStatus.ABORTED
    assert group.status()["members"]["edge1"]["result_s"] is None


async def test_the_machine_of_a_goal_dies(robot: Robot) -> None:
    """A goal whose machine is gone is aborted at once, and is carried out by no other; the next one goes to another."""
    await robot.start({"edge1": 0.01, "edge2": 0.01})
    begun: dict[str, asyncio.Event] = {}

    async def serve_forever(name: str) -> None:
        begun[name] = asyncio.Event()

        async def execute(goal: ServerGoal) -> Outcome:
            begun[name].set()
            await goal.cancelled.wait()
            return Outcome(GoalStatus.CANCELED, SEQUENCE)

        await robot.machines[name].graph.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(execute))

    for name in ("edge1", "edge2"):
        await serve_forever(name)
    client = await robot.group.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(1.0)
    goal = await client.send_goal(Goal(SEQUENCE))
    await begun["edge1"].wait()
    await robot.machines["edge1"].graph.close()
    robot.links["edge1"].reached(False)
    assert (await goal.result(PATIENCE_S)).status is GoalStatus.ABORTED
    assert not begun["edge2"].is_set()
    after = await client.send_goal(Goal(SEQUENCE))
    await begun["edge2"].wait()
    assert await after.cancel()
