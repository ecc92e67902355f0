"""What a node is on the network."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import socket
from collections.abc import AsyncIterator
from urllib.parse import urlsplit

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.networks.ros1.graph import Ros1Graph
from ropeway.networks.ros1.master import master_uri
from ropeway.networks.ros1.node import Ros1Node, is_loopback, our_host
from ropeway.networks.ros1.xmlrpc import XmlRpcClient
from ropeway.types import TypeRegistry
from ropeway.types.ros1_types import Ros1Types

from .conftest import Join


@pytest.fixture
async def client() -> AsyncIterator[XmlRpcClient]:
    made = XmlRpcClient()
    yield made
    await made.close()


async def test_host(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node is reached by what ROS_HOSTNAME or ROS_IP say, else by loopback where the master is there."""
    for name in ("ROS_HOSTNAME", "ROS_IP"):
        monkeypatch.delenv(name, raising=False)
    assert await our_host("localhost") == "127.0.0.1"
    assert await our_host("127.0.0.1") == "127.0.0.1"
    monkeypatch.setenv("ROS_IP", "10.1.2.3")
    assert await our_host("127.0.0.1") == "10.1.2.3"
    monkeypatch.setenv("ROS_HOSTNAME", "robot")
    assert await our_host("127.0.0.1") == "robot"
    assert [is_loopback(host) for host in ("localhost", "127.0.1.1", "::1", "robot", "10.1.2.3")] == [
        True,
        True,
        True,
        False,
        False,
    ]


def test_master_uri(monkeypatch: pytest.MonkeyPatch) -> None:
    """Masters are written as a URI or as host and port, or come from the environment."""
    monkeypatch.setenv("ROS_MASTER_URI", "http://robot:11312/")
    assert master_uri() == "http://robot:11312"
    assert master_uri("other") == "http://other:11311"
    assert master_uri("http://[::1]:5") == "http://[::1]:5"
    for bad in ("https://x", "http://", "http://x:y", "http://x/path"):
        with pytest.raises(GraphUnavailable, match="ros1:http://host:11311"):
            master_uri(bad)


async def test_api(join: Join, client: XmlRpcClient) -> None:
    """The API of a node answers what the tools of ROS 1 ask, and refuses what makes no sense."""
    graph = await join()
    node = graph._node
    assert node is not None
    await graph.create_publisher("/chatter", "std_msgs/msg/String")
    await graph.create_subscription("/heard", "std_msgs/msg/String", None, lambda _: None)
    us = [["/chatter", "std_msgs/String"]]
    assert (await client.call(node.uri, "getPublications", "/x"))[0::2] == [1, us]
    assert (await client.call(node.uri, "getSubscriptions", "/x"))[2] == [["/heard", "std_msgs/String"]]
    assert (await client.call(node.uri, "getMasterUri", "/x"))[2] == node.master.uri
    assert (await client.call(node.uri, "getPid", "/x"))[0] == 1
    for method in ("getBusInfo", "getBusStats"):
        assert (await client.call(node.uri, method, "/x"))[0] == 1
    answer = await client.call(node.uri, "requestTopic", "/x", "/chatter", [["TCPROS"]])
    assert answer[2] == ["TCPROS", "127.0.0.1", node.port]
    assert (await client.call(node.uri, "requestTopic", "/x", "/chatter", [["UDPROS", 1]]))[0] == 0
    for method, params in (
        ("requestTopic", ("/x", "/none", [["TCPROS"]])),
        ("requestTopic", ("/x",)),
        ("publisherUpdate", ("/x", "/none", [])),
        ("publisherUpdate", (1, 2, 3)),
        ("nonsense", ()),
    ):
        assert (await client.call(node.uri, method, *params))[0] == -1, method


async def test_shutdown(join: Join, client: XmlRpcClient) -> None:
    """A request to shut down that does not come from a change of names is not followed."""
    graph = await join()
    node = graph._node
    assert node is not None
    await client.call(node.uri, "shutdown", "/x", "because I say so")
    publisher = await graph.create_publisher("/chatter", "std_msgs/msg/String")
    assert not publisher.closed
    assert graph.node == "/near"


@pytest.mark.parametrize("turns", range(5))
async def test_who_comes_at_the_end(turns: int, recwarn: pytest.WarningsRecorder) -> None:
    """Whoever connects while a node leaves finds the connection closed, and nothing of it is left open."""
    node = Ros1Node(Ros1Graph("http://127.0.0.1:9"), "/near", "http://127.0.0.1:9", Ros1Types(TypeRegistry()))
    await node.open()
    ports = (node.port, urlsplit(node.uri).port or 0)
    peers = [socket.create_connection(("127.0.0.1", port)) for port in ports for _ in range(5)]
    for _ in range(turns):  # they wait, are being accepted, or are there
        await asyncio.sleep(0)
    await node.close()
    for peer in peers:
        with peer, contextlib.suppress(ConnectionError):
            peer.settimeout(0)
            assert peer.recv(1) == b""
    gc.collect()
    assert [str(warning.message) for warning in recwarn] == []
