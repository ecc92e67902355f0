"""The ``dds`` graph and two gateways among genuine ROS 2 nodes; skipped where rclpy is not there."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import Publisher, Sample
from ropeway.networks.dds import DdsGraph
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample
from tests.support.ros2 import CYCLONE, FAST, Peer, has_rmw, need_rclpy, need_rmw, start_peer
from tests.support.until import until

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]
need_rclpy()

IMAGE = "sensor_msgs/msg/Image"
PROGRAM = Path(__file__).with_name("ros2_peer.py")
RMWS = (CYCLONE, FAST)
DOMAIN = 120 + os.getpid() % 10  # and ten further on for the other network


class World:
    """Genuine nodes of one middleware, and our graphs and gateways beside them."""

    def __init__(self, rmw: str, stack: AsyncExitStack) -> None:
        self.rmw, self.stack = rmw, stack

    async def node(self, *words: str, domain: int = DOMAIN, rmw: str = "") -> Peer:
        env = {"RMW_IMPLEMENTATION": rmw or self.rmw, "ROS_DOMAIN_ID": str(domain)}
        peer = await start_peer(self.stack, PROGRAM, *words, env=env)
        if words[0] != "look":
            await peer.wait(lambda: peer.said)
            assert peer.said[0]["ready"] == (rmw or self.rmw)
        return peer

    async def graph(self, domain: int = DOMAIN) -> DdsGraph:
        graph = DdsGraph(domain, name="ours", interface="lo", registry=TypeRegistry())
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph


@pytest.fixture(params=RMWS)
async def world(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[World]:
    """Nodes of one middleware that stay on this machine; all are ended."""
    need_rmw(request.param)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)  # genuine nodes have no tag
    async with AsyncExitStack() as stack:
        yield World(request.param, stack)


def texts(inbox: Inbox) -> list[str]:
    """The strings that arrived."""
    codec = TypeRegistry().codec(STRING)
    return [codec.decode(payload)["data"] for payload in inbox.payloads]


async def test_hears_a_genuine_publisher(world: World) -> None:
    """What a node publishes arrives, and the node, its type hash and its profile are seen."""
    await world.node("pub", "/chatter", STRING, "--node", "talker")
    graph = await world.graph()
    inbox = Inbox()
    await graph.create_subscription("/chatter", STRING, None, inbox)
    await inbox.wait(10, 20)
    heard = texts(inbox)
    first = int(heard[0].split()[1])
    assert heard[:10] == [f"hello {i}" for i in range(first, first + 10)]
    await until(lambda: "/talker" in graph.nodes() and graph.settled)
    (end,) = graph.topics()["/chatter"].publishers
    assert (end.node, end.type, end.qos.reliable) == ("/talker", STRING, True)
    assert end.type_hash == TypeRegistry().hash(STRING)
    assert end.qos.depth == (10 if world.rmw == "rmw_cyclonedds_cpp" else 0)


async def test_what_is_withdrawn_is_gone(world: World) -> None:
    """A genuine node sees a publisher and a subscription of ours come and go again and again, and counts none twice."""
    watcher = await world.node("watch", "/ours", STRING)
    graph = await world.graph()

    def counts() -> list[tuple[int, int]]:
        return [tuple(each["counts"]) for each in watcher.said if "counts" in each]

    for _ in range(3):
        publisher = await graph.create_publisher("/ours", STRING, QoS(depth=10))
        subscription = await graph.create_subscription("/ours", STRING, None, Inbox())
        await watcher.wait(lambda: counts()[-1] == (1, 1))
        await publisher.close()
        await subscription.close()
        await watcher.wait(lambda: counts()[-1] == (0, 0))
    assert max(counts()) == (1, 1)


async def test_is_heard_by_a_genuine_reader(world: World) -> None:
    """What we publish arrives at a node, in order and without loss."""
    listener = await world.node("sub", "/cmd", STRING, "--depth", "100")
    graph = await world.graph()
    publisher = await graph.create_publisher("/cmd", STRING, QoS(depth=100))
    await until(lambda: publisher.subscribers == 1)
    await reached(publisher, listener)
    before = len(listener.heard)
    for i in range(50):
        publisher.publish(sample(str(i)))
    await listener.wait(lambda: len(listener.heard) >= before + 50)
    assert listener.heard[before:] == [str(i) for i in range(50)]


async def reached(publisher: Publisher, listener: Peer) -> None:
    """Publish until the reader hears it: a node may match a little later than it is matched."""

    async def publish() -> None:
        while True:
            publisher.publish(sample("are you there"))
            await asyncio.sleep(0.1)

    publishing = asyncio.create_task(publish())
    await listener.wait(lambda: listener.heard)
    publishing.cancel()
    await asyncio.sleep(0.3)


async def test_latched(world: World) -> None:
    """Latched messages reach those who come late, both ways."""
    await world.node("pub", "/map", STRING, "--latched", "--count", "3", "--hz", "100", "--depth", "5")
    graph = await world.graph()
    publisher = await graph.create_publisher("/our_map", STRING, LATCHED)
    publisher.publish(sample("ours"))
    listener = await world.node("sub", "/our_map", STRING, "--latched")
    inbox = Inbox()
    await until(lambda: "/map" in graph.topics())
    await graph.create_subscription("/map", STRING, None, inbox)
    await inbox.wait(3, 20)
    assert texts(inbox) == [f"hello {i}" for i in range(3)]
    await listener.wait(lambda: listener.heard == ["ours"])


async def test_best_effort(world: World) -> None:
    """Best-effort publishers and readers are matched, both ways."""
    await world.node("pub", "/scan", STRING, "--best-effort")
    listener = await world.node("sub", "/our_scan", STRING, "--best-effort")
    graph = await world.graph()
    inbox = Inbox()
    await graph.create_subscription("/scan", STRING, None, inbox)
    await inbox.wait(3, 20)
    publisher = await graph.create_publisher("/our_scan", STRING, SENSOR_DATA)
    await until(lambda: publisher.subscribers == 1)
    await reached(publisher, listener)


async def test_is_seen_by_genuine_nodes(world: World) -> None:
    """A node sees ours, its publisher, the type hash and the profile."""
    graph = await world.graph()
    await graph.create_publisher("/map", STRING, LATCHED)
    looker = await world.node("look", "/map", STRING)
    await looker.wait(lambda: looker.said, 30)
    assert "/ours" in looker.said[0]["nodes"]
    (end,) = looker.said[0]["publishers"]
    assert end["type_hash"].endswith(TypeRegistry().hash(STRING).removeprefix("RIHS01_"))
    assert (end["node"], end["type"], end["reliable"], end["latched"]) == ("/ours", STRING, True, True)


async def test_images_at_60_hz(world: World) -> None:
    """Frames of 305 kB reach a reader at 60 Hz."""
    listener = await world.node("sub", "/image", IMAGE)
    graph = await world.graph()
    registry = TypeRegistry()
    codec = registry.codec(IMAGE)
    publisher = await graph.create_publisher("/image", IMAGE)
    await until(lambda: publisher.subscribers == 1)
    began = time.monotonic()
    for number in range(1, 241):
        sec, nanosec = divmod(time.time_ns(), 10**9)
        header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": str(number)}
        payload = codec.from_json({"header": header, "data": bytes(305_280)})
        publisher.publish(Sample(payload, IMAGE, time.time_ns(), bytes(16), number))
        await asyncio.sleep(max(0.0, began + number / 60 - time.monotonic()))
    await listener.wait(lambda: listener.heard[-1:] == ["240"])
    lately = [s for s in listener.said if "text" in s and int(s["text"]) > 120]
    assert len(lately) == 120
    assert {s["bytes"] for s in lately} == {305_280}


@pytest.mark.parametrize("operation", ["publish", "subscribe"])
async def test_two_gateways(world: World, operation: str) -> None:
    """Two gateways carry live, latched and best-effort topics between two networks of genuine nodes."""
    near, far = DOMAIN, DOMAIN + 10
    names = ("/live", "/latched", "/best_effort")
    cloud = Gateway(
        config.parse(
            {
                "gateway": {"name": "cloud", "graphs": [f"dds:{far}?interface=lo"], "listen": ["ws://127.0.0.1:0"]},
                "remotes": [],
            }
        )
    )
    await world.stack.enter_async_context(cloud)
    address = f"ws://127.0.0.1:{cloud.servers[0].listeners[0].port}"
    routes = {"address": address, operation: [{"name": name, "type": STRING} for name in names]}
    robot = Gateway(
        config.parse({"gateway": {"name": "robot", "graphs": [f"dds:{near}?interface=lo"]}, "remotes": [routes]})
    )
    await world.stack.enter_async_context(robot)
    source, sink = (near, far) if operation == "publish" else (far, near)
    other = next(r for r in RMWS if r != world.rmw) if all(map(has_rmw, RMWS)) else world.rmw
    await world.node("pub", "/live", STRING, domain=source)
    await world.node("pub", "/best_effort", STRING, "--best-effort", "--node", "b", domain=source)
    for name in ("one", "two"):
        words = ("--latched", "--count", "1", "--depth", "1", "--node", name, "--text", name)
        await world.node("pub", "/latched", STRING, *words, domain=source)
    live = await world.node("sub", "/live", STRING, domain=sink, rmw=other)
    brief = await world.node("sub", "/best_effort", STRING, "--best-effort", "--node", "b", domain=sink, rmw=other)
    late = await world.node("sub", "/latched", STRING, "--latched", "--node", "l", domain=sink, rmw=other)
    await late.wait(lambda: {"one 0", "two 0"} <= set(late.heard))
    for listener in (live, brief):
        await listener.wait(lambda listener=listener: len(listener.heard) >= 10)
    first = int(live.heard[0].split()[1])
    assert live.heard[:10] == [f"hello {i}" for i in range(first, first + 10)]
