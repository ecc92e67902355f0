"""A genuine ROS 2 node, run as a program of its own by the tests marked ``ros``.

``python ros2_peer.py pub|sub TOPIC TYPE`` prints one JSON line per thing that happens, ``look TOPIC TYPE`` one with
what rclpy shows of the topic.
"""

from __future__ import annotations

import argparse
import importlib
import json
import time
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


def say(**what: Any) -> None:
    """Tell the test something."""
    print(json.dumps(what), flush=True)


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("role", choices=("pub", "sub", "look", "watch"))
    parser.add_argument("topic")
    parser.add_argument("type")
    parser.add_argument("--node", default="peer")
    parser.add_argument("--text", default="hello")
    parser.add_argument("--hz", type=float, default=10.0)
    parser.add_argument("--count", type=int, default=0, help="messages to publish; 0: for ever")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--best-effort", action="store_true")
    parser.add_argument("--latched", action="store_true")
    parser.add_argument("--depth", type=int, default=10)
    parser.add_argument("--bytes", type=int, default=0, help="for sensor_msgs/msg/Image: the size of its data")
    return parser.parse_args()


def made(cls: Any, args: argparse.Namespace, number: int) -> Any:
    """The message to publish."""
    message = cls()
    if hasattr(message, "data"):
        message.data = bytes(args.bytes) if args.bytes else f"{args.text} {number}"
    if hasattr(message, "header"):
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
        message.header.frame_id = f"{args.text} {number}"
    return message


def told(message: Any) -> dict[str, Any]:
    """What the test wants to know of a message that came."""
    data = getattr(message, "data", "")
    if isinstance(data, str):
        return {"at": time.time(), "text": data}
    stamp = message.header.stamp
    delay = time.time() - stamp.sec - stamp.nanosec / 1e9
    return {"at": time.time(), "text": message.header.frame_id, "bytes": len(data), "delay_s": delay}


def look(node: Node, topic: str, end: float) -> None:
    """Tell what there is of a topic once its publisher has a name, or at the end."""
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)
        ends = node.get_publishers_info_by_topic(topic)
        if ends and not any("UNKNOWN" in e.node_name for e in ends):
            break
    say(
        nodes=[f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()],
        publishers=[
            {
                "node": f"{e.node_namespace.rstrip('/')}/{e.node_name}",
                "type": e.topic_type,
                "type_hash": str(e.topic_type_hash),
                "reliable": e.qos_profile.reliability == ReliabilityPolicy.RELIABLE,
                "latched": e.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
            }
            for e in node.get_publishers_info_by_topic(topic)
        ],
    )


def watch(node: Node, topic: str, end: float) -> None:
    """Tell how many publishers and subscriptions a topic has, whenever that changes."""
    known = None
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.05)
        found = node.count_publishers(topic), node.count_subscribers(topic)
        if found != known:
            known = found
            say(counts=found)


def main() -> None:
    """Play the role until the time is over."""
    args = arguments()
    package, kind, name = args.type.split("/")
    cls = getattr(importlib.import_module(f"{package}.{kind}"), name)
    profile = QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=args.depth,
        reliability=ReliabilityPolicy.BEST_EFFORT if args.best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if args.latched else DurabilityPolicy.VOLATILE,
    )
    rclpy.init()
    node = rclpy.create_node(args.node)
    end = time.monotonic() + args.seconds
    if args.role == "look":
        look(node, args.topic, end)
        return
    if args.role == "watch":
        say(ready=rclpy.get_rmw_implementation_identifier())
        watch(node, args.topic, end)
        return
    if args.role == "sub":
        node.create_subscription(cls, args.topic, lambda message: say(**told(message)), profile)
        say(ready=rclpy.get_rmw_implementation_identifier())
        while time.monotonic() < end:
            rclpy.spin_once(node, timeout_sec=0.1)
        return
    publisher = node.create_publisher(cls, args.topic, profile)
    say(ready=rclpy.get_rmw_implementation_identifier())
    began = time.monotonic()
    number = 0
    while time.monotonic() < end:
        more = not args.count or number < args.count
        if more:
            publisher.publish(made(cls, args, number))
            number += 1
        due = began + number / args.hz if more else end
        while (left := due - time.monotonic()) > 0:
            rclpy.spin_once(node, timeout_sec=left)


if __name__ == "__main__":
    main()
