"""Actions with Debian's actionlib."""

from __future__ import annotations

import asyncio
import struct

import pytest

from ropeway.errors import GoalRejected
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, ServerGoal
from ropeway.types import TypeRegistry
from tests.support.until import PATIENCE_S, until

from .conftest import Join
from .network import HAS_ROSPY, RosMaster, rospy

pytestmark = pytest.mark.skipif(not HAS_ROSPY, reason="needs ROS 1's actionlib, which .ci/run installs on Debian")

TEST = "actionlib/action/Test"

SIMPLE_SERVER = """
import rospy, actionlib
from actionlib.msg import TestAction, TestResult, TestFeedback
rospy.init_node("server")
def execute(goal):
    print("goal", goal.goal)
    server.publish_feedback(TestFeedback(goal.goal + 1))
    if goal.goal == 2:
        server.set_aborted(TestResult(22), "two is too much")
        return
    while goal.goal == 3 and not server.is_preempt_requested():
        rospy.sleep(0.02)
    if server.is_preempt_requested():
        server.set_preempted(TestResult(33))
    else:
        server.set_succeeded(TestResult(goal.goal * 10))
server = actionlib.SimpleActionServer("/work", TestAction, execute, auto_start=False)
server.start()
print("ready")
rospy.spin()
"""

REJECTING_SERVER = """
import rospy, actionlib
from actionlib.msg import TestAction
rospy.init_node("server")
server = actionlib.ActionServer("/work", TestAction, lambda goal: goal.set_rejected(), auto_start=False)
server.start()
rospy.spin()
"""

CLIENT = f"""
import rospy, actionlib
from actionlib.msg import TestAction, TestGoal
rospy.init_node("client")
client = actionlib.SimpleActionClient("/work", TestAction)
assert client.wait_for_server(rospy.Duration({PATIENCE_S}))
for number in (1, 2, 4):
    client.send_goal(TestGoal(number))
    client.wait_for_result(rospy.Duration({PATIENCE_S}))
    print("ended", number, client.get_state(), client.get_result().result, client.get_goal_status_text())
def advance(feedback):
    print("feedback", feedback.feedback)
    client.cancel_goal()
client.send_goal(TestGoal(3), feedback_cb=advance)
client.wait_for_result(rospy.Duration({PATIENCE_S}))
print("ended", 3, client.get_state(), client.get_result().result)
print("done")
"""


def number(value: int) -> bytes:
    """A Test_Goal, Test_Result or Test_Feedback as CDR."""
    return b"\0\1\0\0" + struct.pack("<i", value)


@pytest.fixture
def registry() -> TypeRegistry:
    made = TypeRegistry()
    made.add_text(TEST, "int32 goal\n---\nint32 result\n---\nint32 feedback\n")
    return made


async def test_client(master: RosMaster, join: Join, registry: TypeRegistry) -> None:
    """Goals for a SimpleActionServer succeed, are aborted with its text, and are cancelled; feedback comes."""
    graph = await join(registry=registry)
    async with rospy(master, SIMPLE_SERVER) as server:
        client = await graph.create_action_client("/work", TEST)
        assert await client.wait_available(PATIENCE_S), server.errors
        feedback: list[bytes] = []
        sent = await client.send_goal(Goal(number(1)), on_feedback=feedback.append)
        assert await sent.result(PATIENCE_S) == Outcome(GoalStatus.SUCCEEDED, number(10))
        await until(lambda: feedback == [number(2)])
        sent = await client.send_goal(Goal(number(2)))
        assert await sent.result(PATIENCE_S) == Outcome(GoalStatus.ABORTED, number(22), "two is too much")
        sent = await client.send_goal(Goal(number(3)))
        assert await sent.cancel()
        outcome = await sent.result(PATIENCE_S)
        assert (outcome.status, outcome.payload) == (GoalStatus.CANCELED, number(33))
        await until(lambda: graph.actions()["/work"].type == TEST)
        assert [provider.node for provider in graph.actions()["/work"].servers] == ["/server"]
        assert not [topic for topic in graph.topics() if topic.startswith("/work/")]


async def test_killed_server(master: RosMaster, join: Join, registry: TypeRegistry) -> None:
    """A server that is killed aborts its goals."""
    graph = await join(registry=registry)
    async with rospy(master, SIMPLE_SERVER) as server:
        client = await graph.create_action_client("/work", TEST)
        assert await client.wait_available(PATIENCE_S), server.errors
        sent = await client.send_goal(Goal(number(3)))
        await server.kill()
        outcome = await sent.result(PATIENCE_S)
    assert (outcome.status, outcome.text) == (GoalStatus.ABORTED, "the action server has gone")


async def test_rejected(master: RosMaster, join: Join, registry: TypeRegistry) -> None:
    """A goal that an actionlib server rejects is rejected."""
    graph = await join(registry=registry)
    async with rospy(master, REJECTING_SERVER):
        client = await graph.create_action_client("/work", TEST)
        assert await client.wait_available(PATIENCE_S)
        with pytest.raises(GoalRejected):
            await client.send_goal(Goal(number(1)))


async def test_server(master: RosMaster, join: Join, registry: TypeRegistry) -> None:
    """A SimpleActionClient gets feedback, results and texts, sees its goals rejected and cancels one."""
    graph = await join(registry=registry)

    async def execute(goal: ServerGoal) -> Outcome:
        value = struct.unpack("<i", goal.payload[4:])[0]
        goal.feedback(number(value + 1))
        if value == 2:
            return Outcome(GoalStatus.ABORTED, number(22), "two is too much")
        if value == 3:
            while not goal.cancelled.is_set():
                goal.feedback(number(4))
                await asyncio.sleep(0.02)
            return Outcome(GoalStatus.CANCELED, number(33))
        return Outcome(GoalStatus.SUCCEEDED, number(value * 10))

    async def accept(goal: ServerGoal) -> bool:
        return goal.payload != number(4)

    await graph.create_action_server("/work", TEST, ActionHandlers(execute, accept))
    async with rospy(master, CLIENT) as client:
        await client.wait_for("done")
    for line in ("ended 1 3 10", "ended 2 4 22 two is too much", "ended 4 5 0", "feedback 4", "ended 3 2 33"):
        assert any(printed.startswith(line) for printed in client.lines), (line, client.lines, client.errors)
