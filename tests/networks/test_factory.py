"""Graphs by their addresses."""

from __future__ import annotations

import importlib.util

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.networks import make_graph

SOURCED = importlib.util.find_spec("rclpy") is not None


def test_kinds() -> None:
    """Each kind of address makes its kind of graph."""
    for url, kind, name in (
        ("dds:7", "dds", "dds:7"),
        ("ros2:7", "ros2", "ros2:7"),
        ("zenoh", "zenoh", "zenoh"),
        ("zenoh:tcp/robot:7447?domain=5", "zenoh", "zenoh:tcp/robot:7447?domain=5"),
        ("memory:x", "memory", "memory:x"),
        ("ros1:http://robot:11312", "ros1", "ros1:http://robot:11312"),
        ("ros1://robot", "ros1", "ros1:http://robot:11311"),
        ("ws://localhost:9090", "rosbridge", "ws://localhost:9090"),
    ):
        graph = make_graph(url)
        assert (graph.kind, graph.name) == (kind, name)


def test_domain_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """``ros2`` and ``auto`` are in the domain that ROS is told to use."""
    monkeypatch.setenv("ROS_DOMAIN_ID", "12")
    assert make_graph("ros2").name == "ros2:12"
    assert make_graph("auto").name == ("ros2:12" if SOURCED else "dds:12")
    monkeypatch.setenv("ROS_DOMAIN_ID", "twelve")
    for url in ("ros2", "auto"):
        with pytest.raises(GraphUnavailable, match="ROS_DOMAIN_ID"):
            make_graph(url)


def test_master_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """``ros1`` is the master that ROS is told to use."""
    monkeypatch.setenv("ROS_MASTER_URI", "http://robot:11399/")
    assert make_graph("ros1").name == "ros1:http://robot:11399"
    monkeypatch.delenv("ROS_MASTER_URI")
    assert make_graph("ros1").name == "ros1:http://127.0.0.1:11311"


@pytest.mark.parametrize(
    "url",
    [
        "ros1:https://x",
        "ros1:http://x:99999",
        "ros1:http://x/y",
        "ros2:233",
        "ros2:x",
        "ros2:0?interface=lo",
        "dds:0?color=red",
        "zenoh:robot",
        "zenoh?color=red",
        "rso2:0",
        "http://x",
    ],
)
def test_refused(url: str) -> None:
    """An address that is none, or has an option that its kind does not know, is refused."""
    with pytest.raises(GraphUnavailable):
        make_graph(url)


@pytest.mark.skipif(SOURCED, reason="says what is told where no ROS 2 is sourced")
async def test_needs_ros() -> None:
    """A ``ros2`` graph that cannot be opened says what to source."""
    with pytest.raises(GraphUnavailable, match=r"setup\.bash before starting ropeway"):
        await make_graph("ros2:0").open()


async def test_group() -> None:
    """Several addresses with commas between are a group, one that is no rosbridge server cannot be in it."""
    graph = make_graph("ws://edge1:9090,wss://edge2:9090?token=secret")
    assert graph.kind == "group"
    assert graph.name == "ws://edge1:9090,wss://edge2:9090?token=..."
    with pytest.raises(GraphUnavailable, match="'dds:0' cannot be in a group"):
        make_graph("ws://edge1:9090,dds:0")
