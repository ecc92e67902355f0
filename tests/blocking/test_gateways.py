"""Bridges and gateways of threads."""

from __future__ import annotations

import pytest

from ropeway import ConfigError, TypedMessage, blocking
from ropeway.blocking import BlockingExecutingGoal

ADD = "example_interfaces/srv/AddTwoInts"
FIBONACCI = "example_interfaces/action/Fibonacci"


def test_bridge() -> None:
    """A topic, a service and an action cross from one network to another."""

    def add(request: TypedMessage) -> dict[str, int]:
        return {"sum": request["a"] + request["b"]}

    def execute(goal: BlockingExecutingGoal) -> dict[str, list[int]]:
        return {"sequence": [goal.request["order"]]}

    with (
        blocking.open("memory:bridge-left") as left,
        blocking.open("memory:bridge-right") as right,
        left.publisher("/a", "std_msgs/String", qos="latched") as publisher,
        left.serve("/add", ADD, add),
        left.serve_action("/do", FIBONACCI, execute),
        blocking.open_bridge(left.url, right.url) as bridge,
    ):
        publisher.publish({"data": "hi"})
        bridge.topic("/a")
        bridge.service("/add")
        bridge.action("/do")
        with right.subscribe("/a", timeout_s=10) as subscription:
            assert subscription.receive(timeout_s=10)["data"] == "hi"
        assert right.call("/add", {"a": 1, "b": 2}, timeout_s=10)["sum"] == 3
        with right.action_client("/do", timeout_s=10) as client:
            assert client.send_goal({"order": 5}, timeout_s=10).result(timeout_s=10).succeeded
        assert [row["kind"] for row in bridge.status()] == ["topic", "service", "action"]


def test_gateway() -> None:
    """A gateway serves clients, tells how it stands, and says what is wrong with a configuration."""
    config = {"gateway": {"name": "g", "graphs": ["memory:blocking-gateway"], "listen": ["ws://127.0.0.1:0"]}}
    with blocking.open_gateway(config) as gateway:
        assert gateway.name == gateway.status()["name"] == "g"
        gateway.reload()
        with blocking.open(f"ws://127.0.0.1:{gateway.ports[0]}") as client:
            client.publisher("/a", "std_msgs/String").publish({"data": "hi"})
    with pytest.raises(ConfigError):
        blocking.open_gateway({"gateway": {"graphs": 3}})
