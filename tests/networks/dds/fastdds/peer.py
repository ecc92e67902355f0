"""A genuine ROS 2 node that serves, calls or acts, run as a program of its own by the tests marked ``ros``.

``python peer.py ROLE NAME`` prints one JSON line per thing that happens. Roles: ``serve`` (AddTwoInts, or SetCameraInfo
with ``--big``), ``call``, ``act`` (serves Fibonacci) and ``goal``.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from typing import Any

import rclpy
from rclpy.action import ActionClient, ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node


def say(**what: Any) -> None:
    """Tell the test something."""
    sys.stdout.write(json.dumps(what) + "\n")  # at once, since several threads come here
    sys.stdout.flush()


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("role", choices=("serve", "call", "act", "goal"))
    parser.add_argument("name")
    parser.add_argument("--node", default="peer")
    parser.add_argument("--big", type=int, default=0, help="bytes of text each way, with SetCameraInfo")
    parser.add_argument("--count", type=int, default=1, help="calls")
    parser.add_argument("--base", type=int, default=0, help="the first number to add")
    parser.add_argument("--together", type=int, default=1, help="calls at a time")
    parser.add_argument("--delay", type=float, default=0.0, help="seconds that an answer takes")
    parser.add_argument("--patience", type=float, default=100.0, help="seconds until a call is given up")
    parser.add_argument("--seconds", type=float, default=40.0)
    return parser.parse_args()


def service_type(args: argparse.Namespace) -> Any:
    """The type that the peer speaks."""
    package, name = ("sensor_msgs", "SetCameraInfo") if args.big else ("example_interfaces", "AddTwoInts")
    return getattr(importlib.import_module(f"{package}.srv"), name)


def fibonacci() -> Any:
    """The action that is served and used."""
    return importlib.import_module("example_interfaces.action").Fibonacci


def serve(node: Node, args: argparse.Namespace) -> None:
    """Answer requests."""

    def on_request(request: Any, response: Any) -> Any:
        time.sleep(args.delay)
        if args.big:
            model = request.camera_info.distortion_model
            response.success, response.status_message = True, model[::-1]
            say(asked=len(model))
        else:
            response.sum = request.a + request.b
            say(asked=request.a)
        return response

    node.create_service(service_type(args), args.name, on_request, callback_group=ReentrantCallbackGroup())


def call(node: Node, args: argparse.Namespace, end: float) -> None:
    """Call and check each answer; tell how long each took."""
    cls = service_type(args)
    client = node.create_client(cls, args.name)
    if not client.wait_for_service(timeout_sec=max(0.0, end - time.monotonic())):
        say(served=False)
        return
    say(served=True)
    waiting: dict[int, tuple[float, Any, Any]] = {}
    took, wrong, begun = [], 0, 0
    while (begun < args.count or waiting) and time.monotonic() < end:
        while begun < args.count and len(waiting) < args.together:
            request = cls.Request()
            if args.big:
                request.camera_info.distortion_model = expected = f"{begun:08}" * (args.big // 8)
                expected = expected[::-1]
            else:
                request.a, request.b = args.base + begun, 7
                expected = request.a + 7
            waiting[begun] = (time.perf_counter(), client.call_async(request), expected)
            begun += 1
        rclpy.spin_once(node, timeout_sec=0.05)
        for number, (began, future, expected) in list(waiting.items()):
            if future.done():
                took.append(time.perf_counter() - began)
                answer = future.result()
                wrong += (answer.status_message if args.big else answer.sum) != expected
                del waiting[number]
            elif time.perf_counter() - began > args.patience:
                say(given_up=number)
                del waiting[number]
    took.sort()
    say(answered=len(took), wrong=wrong, p50_ms=took[len(took) // 2] * 1e3 if took else None)


def act(node: Node, args: argparse.Namespace) -> ActionServer:
    """Serve Fibonacci."""
    cls = fibonacci()

    def execute(handle: Any) -> Any:
        numbers = [0, 1]
        for index in range(1, handle.request.order):
            if handle.is_cancel_requested:
                handle.canceled()
                return cls.Result(sequence=numbers)
            numbers.append(numbers[index] + numbers[index - 1])
            handle.publish_feedback(cls.Feedback(sequence=numbers))
            time.sleep(args.delay)
        handle.succeed()
        return cls.Result(sequence=numbers)

    return ActionServer(
        node,
        cls,
        args.name,
        execute,
        callback_group=ReentrantCallbackGroup(),
        cancel_callback=lambda _: rclpy.action.CancelResponse.ACCEPT,
    )


def goal(node: Node, args: argparse.Namespace, end: float) -> None:
    """Send a goal and tell how it ends."""
    cls = fibonacci()
    client = ActionClient(node, cls, args.name)
    if not client.wait_for_server(timeout_sec=max(0.0, end - time.monotonic())):
        say(served=False)
        return
    feedback: list[Any] = []
    sent = client.send_goal_async(cls.Goal(order=args.count), feedback_callback=lambda m: feedback.append(m))
    rclpy.spin_until_future_complete(node, sent, timeout_sec=20)
    if not sent.done():
        say(accepted=None)
        return
    handle = sent.result()
    if not handle.accepted:
        say(accepted=False)
        return
    result = handle.get_result_async()
    rclpy.spin_until_future_complete(node, result, timeout_sec=20)
    done = result.result() if result.done() else None
    say(
        accepted=True,
        status=done.status if done else None,
        sequence=list(done.result.sequence) if done else None,
        feedback=len(feedback),
    )


def main() -> None:
    """Play the role until the time is over."""
    args = arguments()
    rclpy.init()
    node = rclpy.create_node(args.node)
    end = time.monotonic() + args.seconds
    kept = None
    if args.role == "serve":
        serve(node, args)
    elif args.role == "act":
        kept = act(node, args)
    say(ready=rclpy.get_rmw_implementation_identifier())
    if args.role == "call":
        call(node, args, end)
        return
    if args.role == "goal":
        goal(node, args, end)
        return
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    del kept


if __name__ == "__main__":
    main()
