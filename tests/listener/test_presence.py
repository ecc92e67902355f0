"""``/client_count`` and ``/connected_clients``."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from ropeway.hub.hub import Hub
from ropeway.listener.presence import COUNT_TYPE, LIST_TYPE, Presence, ip_address
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.server import RosbridgeServer
from ropeway.qos import LATCHED
from ropeway.types import TypeRegistry
from tests.support.place import Place
from tests.support.until import until

pytestmark = pytest.mark.jumping

_registry = TypeRegistry()
_numbers = itertools.count()


async def listening(graph: MemoryGraph, topic: str, type: str) -> list[dict[str, Any]]:
    """What is told from now on, decoded."""
    told: list[dict[str, Any]] = []
    codec = _registry.codec(type)
    await graph.create_subscription(
        topic, type, LATCHED, lambda batch: told.extend(codec.decode(sample.payload) for sample in batch)
    )
    return told


async def test_clients_come_and_go(place: Place) -> None:
    """The number and the addresses of the clients are told at each change, and latched for those who come late."""
    counts = await listening(place.robot, "/client_count", COUNT_TYPE)
    await until(lambda: counts == [{"data": 0}])
    first = await place.client()
    await until(lambda: counts[-1] == {"data": 1})
    await place.client()
    await until(lambda: counts[-1] == {"data": 2})
    clients = await listening(place.robot, "/connected_clients", LIST_TYPE)
    late = await listening(place.robot, "/client_count", COUNT_TYPE)
    await until(lambda: clients and late == [{"data": 2}])
    assert [client["ip_address"] for client in clients[-1]["clients"]] == ["127.0.0.1", "127.0.0.1"]
    assert all(client["connection_time"]["sec"] > 1_600_000_000 for client in clients[-1]["clients"])
    first.abort()
    await until(lambda: counts[-1] == {"data": 1} and len(clients[-1]["clients"]) == 1)


async def test_a_client_reads_the_count(place: Place) -> None:
    """A client sees itself counted, as with rosbridge."""
    client = await place.client()
    client.send({"op": "subscribe", "topic": "/client_count"})
    assert await client.json() == {"op": "publish", "topic": "/client_count", "msg": {"data": 1}}


async def test_changes_together_are_told_once() -> None:
    """Many clients at once cost one message."""
    network = f"presence-{next(_numbers)}"
    graph, robot = MemoryGraph(network), MemoryGraph(network, node="/robot")
    await graph.open()
    await robot.open()
    presence = Presence(graph, _registry, clock=lambda: 7_000_000_009)
    presence.joined("early", "::1")
    await presence.open()
    clients = await listening(robot, "/connected_clients", LIST_TYPE)
    await until(lambda: clients)
    for number in range(100):
        presence.joined(number, "10.0.0.1")
        presence.left(number)
    presence.left("nobody")
    presence.joined("one", "10.0.0.2")
    await presence.close()
    await presence.close()
    presence.left("one")
    await until(lambda: len(clients) == 2)
    stamp = {"sec": 7, "nanosec": 9}
    assert clients[1]["clients"] == [
        {"ip_address": "::1", "connection_time": stamp},
        {"ip_address": "10.0.0.2", "connection_time": stamp},
    ]
    assert robot.topics().keys() == {"/connected_clients"}
    await robot.close()
    await graph.close()


async def test_switched_off() -> None:
    """A server that is told so publishes nothing about itself, and one that has closed neither."""
    network = f"presence-{next(_numbers)}"
    graph, robot = MemoryGraph(network), MemoryGraph(network, node="/robot")
    await graph.open()
    await robot.open()
    hub = Hub(graph)
    silent = RosbridgeServer(hub, _registry, publish_clients=False, publish_rosout=False)
    await silent.listen("ws://127.0.0.1:0")
    assert not robot.topics()
    await silent.close()
    server = RosbridgeServer(hub, _registry)
    await server.listen("ws://127.0.0.1:0")
    await server.listen("ws://127.0.0.1:0")
    assert {name: len(topic.publishers) for name, topic in robot.topics().items()} == {
        "/client_count": 1,
        "/connected_clients": 1,
        "/rosout": 1,
    }
    await server.close()
    assert not robot.topics()
    assert not hub.views
    await hub.close()
    await robot.close()
    await graph.close()


async def test_a_graph_that_refuses(caplog: pytest.LogCaptureFixture) -> None:
    """A server on a graph that takes no topics serves nevertheless, and says so in the log."""
    graph = MemoryGraph(f"presence-{next(_numbers)}")
    server = RosbridgeServer(Hub(graph), _registry)
    await server.listen("ws://127.0.0.1:0")
    assert server.listeners
    await server.close()
    assert "does not accept what the server says about itself" in caplog.text


@pytest.mark.parametrize(
    ("peer", "address"),
    [
        ("192.168.1.7:40222", "192.168.1.7"),
        ("[::1]:40222", "::1"),
        ("::1", "::1"),
        ("fe80::1%eth0", "fe80::1%eth0"),
        ("a client", "a client"),
        ("", ""),
    ],
)
def test_addresses(peer: str, address: str) -> None:
    """The address of a peer is told without its port."""
    assert ip_address(peer) == address
