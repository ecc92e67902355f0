"""A genuine ROS 2 node that serves or calls, run as a program of its own by the tests marked ``ros``.

It prints one JSON line per thing that happens.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from typing import Any

import rclpy
from example_interfaces.action import Fibonacci
from example_interfaces.srv import AddTwoInts
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node


def say(**what: Any) -> None:
    """Tell the test something."""
    print(json.dumps(what), flush=True)


def serve(node: Node, args: argparse.Namespace) -> None:
    """Add numbers until the time is over."""
    seen: list[int] = []

    def add(request: Any, response: Any) -> Any:
        time.sleep(args.delay)
        seen.append(request.a)
        response.sum = request.a + request.b
        if len(seen) % 100 == 0 or len(seen) < 10:
            say(served=len(seen), different=len(set(seen)))
        return response

    node.create_service(AddTwoInts, args.name, add)
    say(ready=rclpy.get_rmw_implementation_identifier())
    spin(node, args.seconds)


def call(node: Node, args: argparse.Namespace) -> None:
    """Call one after the other, or all at once, and tell how it went."""
    client = node.create_client(AddTwoInts, args.name)
    found = client.wait_for_service(args.seconds)
    say(ready=rclpy.get_rmw_implementation_identifier(), found=found)
    times, futures = [], []
    for number in range(args.count):
        began = time.perf_counter()
        futures.append(client.call_async(AddTwoInts.Request(a=number, b=1)))
        if args.burst:
            rclpy.spin_once(node, timeout_sec=0)
        else:
            rclpy.spin_until_future_complete(node, futures[-1], timeout_sec=args.patience)
            times.append(time.perf_counter() - began)
    end = time.monotonic() + args.patience
    while time.monotonic() < end and not all(f.done() for f in futures):
        rclpy.spin_once(node, timeout_sec=0.05)
    right = sum(f.done() and f.result().sum == number + 1 for number, f in enumerate(futures))
    say(right=right, p50_us=statistics.median(times) * 1e6 if times else None)


def act(node: Node, args: argparse.Namespace) -> None:
    """Count Fibonacci numbers until the time is over."""

    def execute(goal: Any) -> Any:
        sequence = [0, 1]
        while len(sequence) < goal.request.order:
            if goal.is_cancel_requested:
                goal.canceled()
                return Fibonacci.Result(sequence=sequence)
            sequence.append(sequence[-1] + sequence[-2])
            goal.publish_feedback(Fibonacci.Feedback(sequence=sequence))
            time.sleep(args.delay)
        if goal.request.order > 40:
            goal.abort()
        else:
            goal.succeed()
        return Fibonacci.Result(sequence=sequence)

    server = ActionServer(
        node,
        Fibonacci,
        args.name,
        execute,
        goal_callback=lambda goal: (
            rclpy.action.GoalResponse.ACCEPT if goal.order >= 0 else rclpy.action.GoalResponse.REJECT
        ),
        cancel_callback=lambda _: CancelResponse.ACCEPT,
    )
    say(ready=rclpy.get_rmw_implementation_identifier())
    spin(node, args.seconds)
    server.destroy()


def goal(node: Node, args: argparse.Namespace) -> None:
    """Send one goal, ask for its end after some feedback where told so, and tell how it went."""
    client = ActionClient(node, Fibonacci, args.name)
    found = client.wait_for_server(args.seconds)
    say(ready=rclpy.get_rmw_implementation_identifier(), found=found)
    heard: list[int] = []
    sent = client.send_goal_async(
        Fibonacci.Goal(order=args.order), feedback_callback=lambda m: heard.append(len(m.feedback.sequence))
    )
    rclpy.spin_until_future_complete(node, sent, timeout_sec=args.patience)
    handle = sent.result()
    if handle is None or not handle.accepted:
        say(accepted=handle is not None and handle.accepted)
        return
    if args.cancel:
        while len(heard) < 2:
            rclpy.spin_once(node, timeout_sec=0.1)
        cancelling = handle.cancel_goal_async()
        rclpy.spin_until_future_complete(node, cancelling, timeout_sec=args.patience)
        say(cancelling=len(cancelling.result().goals_canceling))
    ended = handle.get_result_async()
    rclpy.spin_until_future_complete(node, ended, timeout_sec=args.patience)
    outcome = ended.result()
    say(accepted=True, status=outcome.status, sequence=list(outcome.result.sequence), heard=heard)


def spin(node: Node, seconds: float) -> None:
    """Let the node work."""
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.2)


def main() -> None:
    """Play the role."""
    parser = argparse.ArgumentParser()
    parser.add_argument("role", choices=("serve", "call", "act", "goal"))
    parser.add_argument("name")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--patience", type=float, default=10.0)
    parser.add_argument("--delay", type=float, default=0.0)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--burst", action="store_true")
    parser.add_argument("--order", type=int, default=6)
    parser.add_argument("--cancel", action="store_true")
    args = parser.parse_args()
    rclpy.init()
    node = rclpy.create_node("peer")
    {"serve": serve, "call": call, "act": act, "goal": goal}[args.role](node, args)


if __name__ == "__main__":
    main()
