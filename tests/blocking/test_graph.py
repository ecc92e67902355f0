"""A graph that threads use."""

from __future__ import annotations

from pathlib import Path

import pytest

from ropeway import UnknownType, blocking


def test_what_there_is(network: str) -> None:
    """A graph lists what there is, counts what it drops, and knows its URL."""
    with blocking.open(network, name="one") as graph, graph.publisher("/a", "std_msgs/String"):
        assert graph.url == network
        assert graph.topics() == {"/a": ("std_msgs/msg/String",)}
        assert (graph.services(), graph.actions(), graph.nodes()) == ({}, {}, ["/one"])
        assert sum(graph.drops.values()) == 0


def test_own_types(network: str, tmp_path: Path) -> None:
    """Definitions of the user's are known where they are named."""
    (tmp_path / "my_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "my_msgs" / "msg" / "Level.msg").write_text("float32 percent\n")
    with blocking.open(network, types=[tmp_path]) as graph:
        graph.publisher("/l", "my_msgs/Level").publish({"percent": 0.5})
    with blocking.open(network) as graph, pytest.raises(UnknownType):
        graph.publisher("/l", "my_msgs/Level")


async def test_beside_asyncio(network: str) -> None:
    """A notebook, whose thread runs an event loop already, can use it."""
    with (
        blocking.open(network) as graph,
        graph.publisher("/a", "std_msgs/String") as publisher,
        graph.subscribe("/a") as subscription,
    ):
        publisher.publish({"data": "hi"})
        assert subscription.receive()["data"] == "hi"
