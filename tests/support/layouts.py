"""An action whose messages have another layout on another distribution of ROS 2."""

from __future__ import annotations

from ropeway.graph.calls import ActionClient, ActionHandlers, Goal, GoalStatus, Outcome, ServerGoal
from ropeway.types import TypeRegistry
from tests.support.until import until

__all__ = ["GO", "LOOK", "RANGE", "drive_8_m", "halves"]

RANGE, LOOK, GO = "sensor_msgs/msg/Range", "my_msgs/srv/Look", "my_msgs/action/Go"


def halves(registry: TypeRegistry, fed: list[float], **end: object) -> ActionHandlers:
    """Carry a goal out in the layouts of ``registry``: half the way is feedback, and the end waits for its arrival.

    ``end`` is what the result says beside the range.
    """

    async def execute(goal: ServerGoal) -> Outcome:
        far = registry.codec(f"{GO}_Goal").decode(goal.payload)["goal"]["range"]
        goal.feedback(registry.codec(f"{GO}_Feedback").encode({"way": {"range": far / 2}}))
        await until(lambda: bool(fed))
        return Outcome(GoalStatus.SUCCEEDED, registry.codec(f"{GO}_Result").encode({"end": {"range": far}, **end}))

    return ActionHandlers(execute)


async def drive_8_m(client: ActionClient, registry: TypeRegistry, fed: list[float], timeout_s: float) -> None:
    """Send a goal in the layouts of ``registry``; its feedback and its result must come in the same."""
    assert await client.wait_available(timeout_s)
    goal = await client.send_goal(
        Goal(registry.codec(f"{GO}_Goal").encode({"goal": {"range": 8.0}})),
        on_feedback=lambda way: fed.append(registry.codec(f"{GO}_Feedback").decode(way)["way"]["range"]),
        timeout_s=timeout_s,
    )
    outcome = await goal.result(timeout_s)
    assert outcome.payload is not None
    assert registry.codec(f"{GO}_Result").decode(outcome.payload)["end"]["range"] == 8.0
    assert fed == [4.0]
