"""One fixture per kind of graph: two participants of the same network, opened."""

from __future__ import annotations

import importlib.util
import itertools
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from ropeway.graph.base import Graph
from ropeway.group.graph import Group
from ropeway.hub.hub import Hub
from ropeway.networks.dds import DdsGraph
from ropeway.networks.iort.graph import IortGraph
from ropeway.networks.iort.links import LocalLink, RemoteLink
from ropeway.networks.iort.server import IortServer
from ropeway.networks.iort.space import Space
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.mqtt.address import parse_address
from ropeway.networks.mqtt.graph import MqttGraph
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.node import OverlayNode
from ropeway.networks.ros1 import Ros1Graph
from ropeway.networks.ros2 import Ros2Graph
from ropeway.networks.rosbridge.client import RosbridgeGraph
from ropeway.networks.rosbridge.server import RosbridgeServer
from ropeway.networks.zenoh import ZenohGraph
from ropeway.networks.zenoh.address import ZenohAddress
from ropeway.store import Store, StoreLimits, make_backend
from ropeway.types import TypeRegistry
from tests.networks.mqtt.broker import HAS_BROKER, Broker
from tests.networks.overlay.fleet import member
from tests.networks.ros1.network import HAS_MASTER, RosMaster
from tests.networks.ros2.network import isolated_ros2
from tests.support.ports import free_endpoint
from tests.support.until import until

_numbers = itertools.count()
_types = TypeRegistry()


class Pair:
    """Two participants of one network: what ``near`` publishes, ``far`` reads, and the other way round."""

    def __init__(self, near: Graph, far: Graph, stack: AsyncExitStack) -> None:
        self.near, self.far = near, far
        self.stack = stack
        self.can = Abilities()

    def exactly(self, payload: bytes, type: str) -> bytes:
        """``payload``, with zeros for its padding where the network has its own way with it."""
        if self.can.pad_alike:
            return bytes(payload)
        codec = _types.codec(type)
        return codec.encode(codec.decode(payload))


@dataclass(frozen=True)
class Abilities:
    """What the network of a kind can say.

    ``errors``: a service tells why it failed (else the response with default values comes). ``rejects``: a client
    learns that its goal was rejected when it sends it (else with the outcome). ``refuses_cancel``: a client learns that
    its goal goes on (else the request counts as agreed to). ``pad_alike``: bytes that mean nothing arrive as they were
    (else there may be some more at the end, and others between the fields). ``calls``: there are services and actions.
    ``shows_qos``: discovery tells the profile
    of a publisher (else a subscription learns it once it is connected). ``demand``: a publisher learns of its readers.
    """

    errors: bool = True
    rejects: bool = True
    refuses_cancel: bool = True
    pad_alike: bool = True
    calls: bool = True
    shows_qos: bool = True
    demand: bool = True


ABILITIES = {
    "dds": Abilities(errors=False),
    "iort": Abilities(pad_alike=False, calls=False, demand=False),
    "mqtt": Abilities(pad_alike=False, calls=False, demand=False),
    "iort-local": Abilities(pad_alike=False, calls=False, demand=False),
    "ros1": Abilities(shows_qos=False),
    "ros2": Abilities(errors=False, pad_alike=False),
}
"""Kinds that cannot say everything, the others can."""


async def open_memory(stack: AsyncExitStack) -> Pair:
    network = f"contract-{next(_numbers)}"
    near, far = MemoryGraph(network, node="/near"), MemoryGraph(network, node="/far")
    for graph in (near, far):
        await graph.open()
        stack.push_async_callback(graph.close)
    return Pair(near, far, stack)


async def open_group(stack: AsyncExitStack) -> Pair:
    """A group of one network of two, of which the other is empty; and a participant of that network."""
    network, empty = f"contract-{next(_numbers)}", f"contract-{next(_numbers)}"
    members = {"first": MemoryGraph(network, node="/near"), "second": MemoryGraph(empty, node="/near")}
    near, far = Group(members), MemoryGraph(network, node="/far")
    for graph in (near, far):
        await graph.open()
        stack.push_async_callback(graph.close)
    return Pair(near, far, stack)


async def open_hub(stack: AsyncExitStack) -> Pair:
    """Two views of one graph."""
    graph = MemoryGraph(f"contract-{next(_numbers)}")
    await graph.open()
    stack.push_async_callback(graph.close)
    hub = Hub(graph)
    near, far = hub.view("near"), hub.view("far")
    return Pair(near, far, stack)


async def open_dds(stack: AsyncExitStack) -> Pair:
    """Two participants of one DDS domain, on the loopback interface."""
    near = DdsGraph(58, name="near", interface="lo")
    far = DdsGraph(58, name="far", interface="lo")
    for graph in (near, far):
        await graph.open()
        stack.push_async_callback(graph.close)
    return Pair(near, far, stack)


async def open_ros2(stack: AsyncExitStack) -> Pair:
    """Two nodes of one ROS 2 domain, on the loopback interface, over the middleware of the environment."""
    with isolated_ros2() as domain:
        near, far = Ros2Graph(domain, name="near"), Ros2Graph(domain, name="far")
        for graph in (near, far):
            await graph.open()
            stack.push_async_callback(graph.close)
    return Pair(near, far, stack)


async def open_overlay(stack: AsyncExitStack) -> Pair:
    """Two members of one fleet, linked directly over TLS on the loopback interface."""
    where = free_endpoint()
    near = OverlayNode(member("near"), routers=(), listen=(where,))
    graphs = [OverlayGraph(near)]
    await graphs[0].open()
    stack.push_async_callback(graphs[0].close)
    far = OverlayNode(member("far"), routers=(where,), listen=())
    graphs.append(OverlayGraph(far))
    await graphs[1].open()
    stack.push_async_callback(graphs[1].close)
    await until(lambda: near.membership.gateways() and far.membership.gateways())
    return Pair(graphs[0], graphs[1], stack)


async def open_rosbridge(stack: AsyncExitStack, *, plain: bool = False) -> Pair:
    """Two clients of one server, on a network of its own."""
    graph = MemoryGraph(f"contract-{next(_numbers)}")
    await graph.open()
    stack.push_async_callback(graph.close)
    registry = TypeRegistry()
    server = RosbridgeServer(Hub(graph), registry, unregister_timeout_s=0.05)
    stack.push_async_callback(server.close)
    listener = await server.listen("ws://127.0.0.1:0")
    ends = []
    for name in ("near", "far"):
        end = RosbridgeGraph(f"ws://127.0.0.1:{listener.port}", registry=registry, name=name, plain=plain)
        await end.open()
        stack.push_async_callback(end.close)
        ends.append(end)
    return Pair(ends[0], ends[1], stack)


async def open_space(stack: AsyncExitStack) -> Space:
    """Topics of IoRT nodes, kept in memory."""
    store = Store(make_backend("memory:"), limits=StoreLimits(max_value_bytes=64 << 20))
    await store.open()
    stack.push_async_callback(store.close)
    return Space(store)


async def open_iort(stack: AsyncExitStack) -> Pair:
    """Two nodes of one server."""
    server = IortServer(await open_space(stack), max_packet_bytes=64 << 20)
    stack.push_async_callback(server.close)
    port = await server.listen("iort://127.0.0.1:0")
    ends = []
    for name in ("near", "far"):
        url = f"iort://127.0.0.1:{port}"
        end = IortGraph(RemoteLink(url, name), name=url)
        await end.open()
        stack.push_async_callback(end.close)
        ends.append(end)
    return Pair(ends[0], ends[1], stack)


async def open_iort_local(stack: AsyncExitStack) -> Pair:
    """Two members of one space in this process."""
    space = await open_space(stack)
    ends = [IortGraph(LocalLink(space, name), name=f"iort:{name}") for name in ("near", "far")]
    for end in ends:
        await end.open()
        stack.push_async_callback(end.close)
    return Pair(ends[0], ends[1], stack)


async def open_ros1(stack: AsyncExitStack) -> Pair:
    """Two nodes of one ROS 1 master."""
    directory = stack.enter_context(TemporaryDirectory())
    master = RosMaster(Path(directory))
    stack.callback(master.kill)
    master.start()
    ends = [Ros1Graph(master.uri, name=name, poll_s=0.1, registry=_types) for name in ("near", "far")]
    for end in ends:
        await end.open()
        stack.push_async_callback(end.close)
    return Pair(ends[0], ends[1], stack)


async def open_zenoh(stack: AsyncExitStack) -> Pair:
    """Two nodes on a network of rmw_zenoh, of which one connects to the other."""
    where = (f"tcp/{free_endpoint().partition('/')[2]}",)
    addresses = (ZenohAddress(0, (), where, "peer"), ZenohAddress(0, where, (), "peer"))
    ends = [ZenohGraph(address, name=name) for address, name in zip(addresses, ("near", "far"), strict=True)]
    for end in ends:
        await end.open()
        stack.push_async_callback(end.close)
    await until(lambda: all("/near" in end.nodes() and "/far" in end.nodes() for end in ends))
    return Pair(ends[0], ends[1], stack)


async def open_mqtt(stack: AsyncExitStack) -> Pair:
    """Two gateways at one broker."""
    broker = stack.enter_context(Broker())
    ends = [MqttGraph(parse_address(broker.url), node=name) for name in ("near", "far")]
    for end in ends:
        await end.open()
        stack.push_async_callback(end.close)
    return Pair(ends[0], ends[1], stack)


KINDS: dict[str, Callable[[AsyncExitStack], Any]] = {
    "memory": open_memory,
    "hub": open_hub,
    "group": open_group,
    "iort": open_iort,
    "iort-local": open_iort_local,
    "dds": open_dds,
    "overlay": open_overlay,
    "rosbridge": open_rosbridge,
    "zenoh": open_zenoh,
}
if HAS_MASTER:
    KINDS["ros1"] = open_ros1
if HAS_BROKER:
    KINDS["mqtt"] = open_mqtt
if importlib.util.find_spec("rclpy") is not None:
    KINDS["ros2"] = open_ros2


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Networks without services and actions are not asked for them."""

    def fits(item: pytest.Item) -> bool:
        kind = getattr(item, "callspec", None) and item.callspec.params.get("pair")  # type: ignore[attr-defined]
        calls = item.path.name in ("test_services.py", "test_actions.py") and item.path.parent.name == "contract"
        return not calls or ABILITIES.get(str(kind), Abilities()).calls

    kept = [item for item in items if fits(item)]
    if len(kept) < len(items):
        config.hook.pytest_deselected(items=[item for item in items if not fits(item)])
        items[:] = kept


@pytest.fixture(params=sorted(KINDS))
async def pair(request: pytest.FixtureRequest) -> AsyncIterator[Pair]:
    """Two opened participants of one network, for every kind of graph."""
    async with AsyncExitStack() as stack:
        pair = await KINDS[request.param](stack)
        pair.can = ABILITIES.get(request.param, pair.can)
        yield pair
