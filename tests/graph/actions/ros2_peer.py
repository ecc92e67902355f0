"""A node of a genuine ROS 2 that serves or uses Fibonacci actions, and says in JSON lines what it sees.

``serve NAME``: a goal of order n gives n feedbacks; a negative order waits for its cancellation; 7 is rejected.
``use NAME ORDER [--cancel]``: sends one goal, cancels it after its first feedback where asked to, tells its end.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import rclpy
from example_interfaces.action import Fibonacci
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node


def say(**words: Any) -> None:
    """One line for the test."""
    print(json.dumps(words), flush=True)


def serve(node: Node, name: str) -> None:
    """Serve the action until the process is killed."""

    def execute(goal: Any) -> Any:
        order = goal.request.order
        for step in range(max(order, 1)):
            goal.publish_feedback(Fibonacci.Feedback(sequence=list(range(step + 1))))
        while order < 0 and not goal.is_cancel_requested:
            time.sleep(0.01)
        if order < 0:
            goal.canceled()
        else:
            goal.succeed()
        return Fibonacci.Result(sequence=[order])

    ActionServer(
        node,
        Fibonacci,
        name,
        execute,
        callback_group=ReentrantCallbackGroup(),
        goal_callback=lambda goal: GoalResponse.REJECT if goal.order == 7 else GoalResponse.ACCEPT,
        cancel_callback=lambda goal: CancelResponse.ACCEPT,
    )
    executor = MultiThreadedExecutor(8)
    executor.add_node(node)
    say(ready=True)
    executor.spin()


def use(node: Node, name: str, order: int, cancel: bool) -> None:
    """Send one goal and tell how it ends."""
    client = ActionClient(node, Fibonacci, name)
    say(ready=client.wait_for_server(20))
    heard: list[list[int]] = []

    def done(future: Any) -> Any:
        rclpy.spin_until_future_complete(node, future, timeout_sec=20)
        return future.result()

    goal = done(
        client.send_goal_async(
            Fibonacci.Goal(order=order), feedback_callback=lambda m: heard.append(list(m.feedback.sequence))
        )
    )
    if not goal.accepted:
        say(accepted=False)
        return
    future = goal.get_result_async()
    if cancel:
        while not heard:
            rclpy.spin_once(node, timeout_sec=0.1)
        answer = done(goal.cancel_goal_async())
        say(cancelling=len(answer.goals_canceling), code=answer.return_code)
    say(accepted=True)
    result = done(future)
    say(status=result.status, sequence=list(result.result.sequence), first=heard[:1])


def main() -> None:
    """Do what the arguments say."""
    rclpy.init()
    node = Node("genuine")
    try:
        if sys.argv[1] == "serve":
            serve(node, sys.argv[2])
        else:
            use(node, sys.argv[2], int(sys.argv[3]), "--cancel" in sys.argv)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
