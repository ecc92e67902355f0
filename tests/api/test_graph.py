"""Opening a graph, and what there is on it."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path

import pytest

import ropeway
from ropeway import ConnectFailed, GraphUnavailable, InvalidDefinition, UnknownType
from ropeway.networks.rosbridge.client import RosbridgeGraph
from tests.api.conftest import new_network
from tests.support.until import until


async def test_what_there_is(url: str) -> None:
    """A graph lists topics, services and actions with their types, and nodes."""
    async with (
        ropeway.open(url, name="one") as one,
        ropeway.open(url, name="two") as two,
        one.publisher("/a", "std_msgs/String"),
        one.serve("/s", "std_srvs/Empty", lambda request: None),
    ):
        await until(lambda: two.topics()["/a"] == ("std_msgs/msg/String",), 20)
        await until(lambda: two.services()["/s"] == ("std_srvs/srv/Empty",), 20)
        assert two.actions() == {}
        if not url.startswith("ws"):  # a server shows its own node to its clients
            await until(lambda: "/one" in two.nodes(), 20)


@pytest.mark.parametrize(
    ("url", "text"),
    [
        ("dds:999", "write dds:0 to dds:232"),
        ("kafka:x", "is not a graph; write dds:0"),
        ("overlay:nobody.ropeway", "nobody.ropeway"),
    ],
)
async def test_no_graph(url: str, text: str) -> None:
    """A URL that is no graph, or names what is not there, is refused with what to write."""
    with pytest.raises(ropeway.RopewayError, match=text):
        await ropeway.open(url)


async def test_url(url: str) -> None:
    """A graph knows the URL that it was opened with."""
    async with ropeway.open(url) as graph:
        assert graph.url == url


async def test_names() -> None:
    """Graphs without a name of their own have different ones."""
    url = "dds:58?interface=lo"
    async with ropeway.open(url) as one, ropeway.open(url), ropeway.open_bridge(url, "memory:names"):
        await until(lambda: len(one.nodes()) == 3, 20)


async def test_nobody_answers() -> None:
    """A server that cannot be reached is an error at once, one that says nothing is one when the time is over."""
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        url = f"ws://127.0.0.1:{silent.getsockname()[1]}"
        with pytest.raises(ConnectFailed):
            await ropeway.open(url)
        silent.listen()
        with pytest.raises(GraphUnavailable, match=r"did not open within 0\.1 s; give it more with timeout_s"):
            await ropeway.open(url, timeout_s=0.1)


async def test_own_types(network: str, tmp_path: Path) -> None:
    """Definitions of the user's are known where they are named, and a directory without any is an error."""
    (tmp_path / "my_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "my_msgs" / "msg" / "Level.msg").write_text("float32 percent\n")
    async with (
        ropeway.open(network, types=[tmp_path]) as graph,
        graph.publisher("/l", "my_msgs/Level") as publisher,
        graph.subscribe("/l") as subscription,
    ):
        publisher.publish({"percent": 0.5})
        assert (await subscription.receive())["percent"] == 0.5
    async with ropeway.open(network) as graph:
        with pytest.raises(UnknownType):
            await graph.publisher("/l", "my_msgs/Level")
    with pytest.raises(InvalidDefinition):
        await ropeway.open(network, types=[tmp_path / "nothing"])


async def test_cancelled_while_it_opens() -> None:
    """A program that gives up opening a graph leaves no task behind."""
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        before = asyncio.all_tasks()
        opening = asyncio.ensure_future(ropeway.open(f"ws://127.0.0.1:{silent.getsockname()[1]}"))
        await asyncio.sleep(0.05)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        assert asyncio.all_tasks() == before


async def test_close_leaves_nothing_behind() -> None:
    """When a graph behind a server is closed, both connections of the link have ended."""
    config = {"gateway": {"graphs": [new_network()], "listen": ["ws://127.0.0.1:0"]}}
    async with ropeway.open_gateway(config) as gateway, ropeway.open(f"ws://127.0.0.1:{gateway.ports[0]}") as graph:
        link = graph._graph
        assert isinstance(link, RosbridgeGraph)
        peer = link.peer
        assert peer is not None
        await until(lambda: peer.express._connection is not None)
        second = peer.express._connection
        assert second is not None
        await graph.close()
        assert peer.connection.closed
        assert second.closed
        assert not [task for task in asyncio.all_tasks() if task.get_name().startswith(("link ", "second connection"))]
