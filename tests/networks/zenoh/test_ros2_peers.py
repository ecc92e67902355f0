"""The ``zenoh`` graph among genuine nodes of rmw_zenoh; skipped where ROS 2 or this middleware is not there.

Each test runs twice: all through a router, and without one, where the nodes link with ours.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

import ropeway
from ropeway.graph.base import Publisher
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Request
from ropeway.networks.zenoh import ZenohGraph
from ropeway.networks.zenoh.address import ZenohAddress
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from ropeway.types import TypeRegistry
from tests.support.actions import FIBONACCI, count, order, sequence
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample
from tests.support.ros2 import CYCLONE, ZENOH, Peer, has_rmw, need_rclpy, need_rmw, start_peer
from tests.support.services import ADD, add, addends, total
from tests.support.until import PATIENCE_S, until

from .network import endpoint

pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]
need_rclpy()
need_rmw(ZENOH)

NETWORKS = Path(__file__).parents[1]
TOPICS = NETWORKS / "ros2" / "ros2_peer.py"
CALLS = NETWORKS / "dds" / "fastdds" / "peer.py"
DOMAIN = 150 + os.getpid() % 20
REGISTRY = TypeRegistry()


class World:
    """Genuine nodes, and our graphs beside them. ``where`` is the endpoint that all connect to."""

    def __init__(self, stack: AsyncExitStack, *, router: bool) -> None:
        self.stack, self.router, self.where = stack, router, endpoint()
        self._opened = 0

    async def start(self) -> None:
        """Start the router, where there is one."""
        if not self.router:
            return
        program = next(
            found
            for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep)
            if (found := Path(prefix) / "lib" / ZENOH / "rmw_zenohd").exists()
        )
        env = {**os.environ, "RMW_IMPLEMENTATION": ZENOH, **self._override(f'listen/endpoints=["{self.where}"]')}
        devnull = asyncio.subprocess.DEVNULL
        router = await asyncio.create_subprocess_exec(str(program), stdin=devnull, stdout=devnull, env=env)

        async def end() -> None:
            router.terminate()
            await router.wait()

        self.stack.push_async_callback(end)

    async def node(self, program: Path, *words: str) -> Peer:
        """Start a genuine node, and wait until it is ready."""
        local = 'listen/endpoints=["tcp/127.0.0.1:0"]'
        env = {"RMW_IMPLEMENTATION": ZENOH, "ROS_DOMAIN_ID": str(DOMAIN), "ZENOH_ROUTER_CHECK_ATTEMPTS": "-1"}
        env |= self._override(f'connect/endpoints=["{self.where}"];{local}')
        peer = await start_peer(self.stack, program, *words, env=env, politely=True)
        if words[0] != "look":
            await peer.wait(lambda: peer.said)
            assert peer.said[0]["ready"] == ZENOH
        return peer

    def _override(self, settings: str) -> dict[str, str]:
        return {"ZENOH_CONFIG_OVERRIDE": settings}

    def address(self) -> ZenohAddress:
        """Return the address of the next graph of ours; without a router the first one listens for all others."""
        self._opened += 1
        if not self.router and self._opened == 1:
            return ZenohAddress(DOMAIN, (), (self.where,), "peer")
        return ZenohAddress(DOMAIN, (self.where,), ("tcp/127.0.0.1:0",), "peer")

    async def graph(self, name: str = "ours") -> ZenohGraph:
        """Open a graph of ours."""
        graph = ZenohGraph(self.address(), name=name, gateway_id=name, registry=REGISTRY)
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph


@pytest.fixture(params=["router", "peers"])
async def world(request: pytest.FixtureRequest) -> AsyncIterator[World]:
    """A network with or without a router; all nodes are ended."""
    async with AsyncExitStack() as stack:
        world = World(stack, router=request.param == "router")
        await world.start()
        yield world


async def reached(publisher: Publisher, listener: Peer) -> None:
    """Publish until the reader hears it, and until it has heard the last of these."""
    sent = 0

    def heard() -> bool:
        nonlocal sent
        if not listener.heard:
            publisher.publish(sample(f"there? {sent}"))
            sent += 1
        return bool(listener.heard)

    await listener.wait(heard)
    await listener.wait(lambda: listener.heard[-1] == f"there? {sent - 1}")


async def test_hears_a_node(world: World) -> None:
    """What a node publishes arrives, and the node, its type hash and its profile are seen."""
    graph = await world.graph()
    await world.node(TOPICS, "pub", "/chatter", STRING, "--node", "talker", "--depth", "7")
    inbox = Inbox()
    await graph.create_subscription("/chatter", STRING, None, inbox)
    await inbox.wait(10)
    first = int(inbox.texts[0].split()[1])
    assert inbox.texts[:10] == [f"hello {number}" for number in range(first, first + 10)]
    (end,) = graph.topics()["/chatter"].publishers
    assert (end.node, end.type, end.qos) == ("/talker", STRING, QoS(depth=7))
    assert (end.type_hash, end.gid) == (REGISTRY.hash(STRING), inbox.samples[0].origin)
    assert not graph.drops


async def test_is_heard(world: World) -> None:
    """What we publish arrives at a node, in order and without loss."""
    graph = await world.graph()
    listener = await world.node(TOPICS, "sub", "/cmd", STRING, "--depth", "100")
    publisher = await graph.create_publisher("/cmd", STRING, QoS(depth=100))
    await until(lambda: publisher.subscribers == 1)
    await reached(publisher, listener)
    before = len(listener.heard)
    for number in range(50):
        publisher.publish(sample(str(number)))
    await listener.wait(lambda: len(listener.heard) >= before + 50)
    assert listener.heard[before:] == [str(number) for number in range(50)]


async def test_latched(world: World) -> None:
    """Latched messages reach those who come late, both ways, as many as the publisher keeps."""
    graph = await world.graph()
    await world.node(TOPICS, "pub", "/map", STRING, "--latched", "--count", "5", "--hz", "100", "--depth", "3")
    publisher = await graph.create_publisher("/our_map", STRING, LATCHED)
    publisher.publish(sample("ours"))
    listener = await world.node(TOPICS, "sub", "/our_map", STRING, "--latched")
    await listener.wait(lambda: listener.heard == ["ours"])
    late = await world.graph("late")
    await until(lambda: "/map" in late.topics())
    inbox = Inbox()
    await late.create_subscription("/map", STRING, None, inbox)
    await until(lambda: inbox.texts[-1:] == ["hello 4"])
    assert inbox.texts == [f"hello {number}" for number in range(2, 5)]


async def test_best_effort(world: World) -> None:
    """Best-effort publishers and readers hear each other, both ways."""
    graph = await world.graph()
    await world.node(TOPICS, "pub", "/scan", STRING, "--best-effort")
    listener = await world.node(TOPICS, "sub", "/our_scan", STRING, "--best-effort", "--node", "listener")
    inbox = Inbox()
    await graph.create_subscription("/scan", STRING, None, inbox)
    await inbox.wait(3)
    publisher = await graph.create_publisher("/our_scan", STRING, SENSOR_DATA)
    await until(lambda: publisher.subscribers == 1)
    await reached(publisher, listener)


async def test_is_seen(world: World) -> None:
    """A node sees ours, its publisher, the type hash and the profile."""
    graph = await world.graph()
    await graph.create_publisher("/map", STRING, LATCHED)
    looker = await world.node(TOPICS, "look", "/map", STRING)
    await looker.wait(lambda: looker.said)
    assert "/ours" in looker.said[0]["nodes"]
    (end,) = looker.said[0]["publishers"]
    assert end["type_hash"].endswith(REGISTRY.hash(STRING).removeprefix("RIHS01_"))
    assert (end["node"], end["type"], end["reliable"], end["latched"]) == ("/ours", STRING, True, True)


async def test_comes_and_goes(world: World) -> None:
    """A node sees a publisher and a subscription of ours come and go again and again, and counts none twice."""
    graph = await world.graph()
    watcher = await world.node(TOPICS, "watch", "/ours", STRING)

    def counts() -> list[tuple[int, int]]:
        return [tuple(each["counts"]) for each in watcher.said if "counts" in each]

    for _ in range(3):
        publisher = await graph.create_publisher("/ours", STRING)
        subscription = await graph.create_subscription("/ours", STRING, None, Inbox())
        await watcher.wait(lambda: counts()[-1] == (1, 1))
        await publisher.close()
        await subscription.close()
        await watcher.wait(lambda: counts()[-1] == (0, 0))
    assert max(counts()) == (1, 1)


async def test_node_leaves(world: World) -> None:
    """A node that ends is gone with all it had."""
    graph = await world.graph()
    node = await world.node(TOPICS, "pub", "/chatter", STRING, "--node", "talker")
    await until(lambda: "/talker" in graph.nodes() and "/chatter" in graph.topics())
    await node.end()
    await until(lambda: "/talker" not in graph.nodes() and "/chatter" not in graph.topics())


async def test_served(world: World) -> None:
    """A node waits for a service of ours and gets all its answers, as one does that was there before."""
    graph = await world.graph()
    early = await world.node(CALLS, "call", "/add", "--count", "50", "--node", "early", "--seconds", "60")
    await graph.create_service("/add", ADD, add)
    late = await world.node(CALLS, "call", "/add", "--count", "50", "--together", "10", "--seconds", "60")
    for node in (early, late):
        assert (await node.done()).items() >= {"answered": 50, "wrong": 0}.items()
    assert not graph.drops


async def test_called(world: World) -> None:
    """Calls of ours are answered by a node, one after the other and many at a time."""
    graph = await world.graph()
    await world.node(CALLS, "serve", "/add")
    client = await graph.create_client("/add", ADD)
    assert await client.wait_available(PATIENCE_S)
    for number in range(20):
        assert await client.call(Request(addends(number, 7))) == total(number + 7)
    answers = await asyncio.gather(*(client.call(Request(addends(number, 1)), PATIENCE_S) for number in range(100)))
    assert answers == [total(number + 1) for number in range(100)]


async def test_action_used(world: World) -> None:
    """An action of a node gives feedback and a result, and can be cancelled."""
    graph = await world.graph()
    await world.node(CALLS, "act", "/fibonacci", "--delay", "0.1")
    client = await graph.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    feedback: list[bytes] = []
    goal = await client.send_goal(Goal(order(6)), on_feedback=feedback.append, timeout_s=PATIENCE_S)
    outcome = await goal.result(PATIENCE_S)
    assert (outcome.status, outcome.payload) == (GoalStatus.SUCCEEDED, sequence(0, 1, 1, 2, 3, 5, 8))
    assert feedback
    goal = await client.send_goal(Goal(order(600)), timeout_s=PATIENCE_S)
    await goal.cancel()
    assert (await goal.result(PATIENCE_S)).status == GoalStatus.CANCELED


async def test_action_served(world: World) -> None:
    """An action of ours is used by a node."""
    graph = await world.graph()
    await graph.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(count))
    node = await world.node(CALLS, "goal", "/fibonacci", "--count", "6")
    said = await node.done()
    assert said.items() >= {"accepted": True, "status": 4, "sequence": [0, 1, 2, 3, 4, 5]}.items()


async def test_joined_with_dds(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """A node of rmw_zenoh and one of a DDS domain hear each other through a bridge of ours."""
    if not has_rmw(CYCLONE):
        pytest.skip(f"needs {CYCLONE}")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    near = f"zenoh:{world.where}?domain={DOMAIN}"
    if not world.router:
        near = f"zenoh?domain={DOMAIN}&listen={world.where}"
    async with ropeway.open_bridge(near, f"dds:{DOMAIN}?interface=lo") as bridge:
        await bridge.topic("/out", STRING)
        await bridge.topic("/back", STRING, reverse=True)
        env = {"RMW_IMPLEMENTATION": CYCLONE, "ROS_DOMAIN_ID": str(DOMAIN)}
        there = await start_peer(world.stack, TOPICS, "sub", "/out", STRING, "--node", "there", env=env)
        here = await world.node(TOPICS, "sub", "/back", STRING, "--node", "here")
        await world.node(TOPICS, "pub", "/out", STRING, "--node", "source")
        await start_peer(world.stack, TOPICS, "pub", "/back", STRING, "--node", "answer", env=env)
        for listener in (there, here):  # what comes first may be lost while nodes link past the router
            await listener.wait(lambda listener=listener: len(listener.heard) >= 20)
            last = [int(each.split()[1]) for each in listener.heard[-5:]]
            assert last == list(range(last[0], last[0] + 5))
