"""ropeway.gateway.gateway: two gateways, each with a network of its own, over real WebSockets."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.graph.base import Sample
from ropeway.qos import LATCHED, QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.until import until
from tests.support.world import World, url

pytestmark = pytest.mark.jumping


def item(name: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "type": STRING, **more}


async def test_forward(world: World) -> None:
    """A published topic of one network arrives on the other, whole and in order."""
    cloud = await world.gateway("cloud", [])
    await world.gateway("robot", [{"address": url(cloud), "publish": [item("/chatter")]}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    inbox = Inbox()
    await there.create_subscription("/chatter", STRING, QoS(), inbox)
    publisher = await here.create_publisher("/chatter", STRING)
    await until(lambda: publisher.subscribers == 1)
    for i in range(20):
        publisher.publish(sample(str(i)))
        await asyncio.sleep(0)
    await inbox.wait(20)
    assert inbox.payloads == [text(str(i)) for i in range(20)]


@pytest.mark.parametrize("compression", ["none", "png", "cbor", "cbor-raw", "zip", "rawzip", "zstd", "auto"])
@pytest.mark.parametrize("operation", ["publish", "subscribe"])
async def test_every_encoding(world: World, operation: str, compression: str) -> None:
    """Every encoding carries a topic both ways, bit by bit."""
    cloud = await world.gateway("cloud", [])
    routes = {"address": url(cloud), operation: [item("/t", compression=compression)]}
    await world.gateway("robot", [routes])
    here, there = await world.robot("robot"), await world.robot("cloud")
    source, sink = (here, there) if operation == "publish" else (there, here)
    inbox = Inbox()
    await sink.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await source.create_publisher("/t", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("grüße"))
    await inbox.wait(1)
    assert inbox.payloads == [text("grüße")]


async def test_reverse(world: World) -> None:
    """A subscribed topic is fetched from the other network only while somebody here reads it."""
    cloud = await world.gateway("cloud", [])
    await world.gateway("robot", [{"address": url(cloud), "subscribe": [item("/goal")]}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    publisher = await there.create_publisher("/goal", STRING)
    await until(lambda: "/goal" in here.topics())
    await asyncio.sleep(0.2)
    assert publisher.subscribers == 0
    inbox = Inbox()
    subscription = await here.create_subscription("/goal", STRING, QoS(), inbox)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("go"))
    await inbox.wait(1)
    await subscription.close()
    await until(lambda: publisher.subscribers == 0)


async def test_demand(world: World) -> None:
    """A published topic is read here only while somebody there reads it."""
    cloud = await world.gateway("cloud", [])
    await world.gateway("robot", [{"address": url(cloud), "publish": [item("/image")]}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    publisher = await here.create_publisher("/image", STRING)
    await until(lambda: "/image" in there.topics())
    await asyncio.sleep(0.2)
    assert publisher.subscribers == 0
    subscription = await there.create_subscription("/image", STRING, QoS(), Inbox())
    await until(lambda: publisher.subscribers == 1)
    await subscription.close()
    await until(lambda: publisher.subscribers == 0)


async def test_rename(world: World) -> None:
    """Names are mapped both ways: remote_name, and namespaces of the remote."""
    cloud = await world.gateway("cloud", [])
    await world.gateway(
        "robot",
        [
            {
                "address": url(cloud),
                "remote_namespace": "/robot1",
                "trans-publish": [item("/a", remote_name="/fleet/a")],
                "publish": [item("/b")],
                "subscribe": [item("/c")],
            }
        ],
    )
    here, there = await world.robot("robot"), await world.robot("cloud")
    for near, far, source, sink in (
        ("/a", "/fleet/a", here, there),
        ("/b", "/robot1/b", here, there),
        ("/c", "/robot1/c", there, here),
    ):
        inbox = Inbox()
        await sink.create_subscription(far if sink is there else near, STRING, QoS(), inbox)
        publisher = await source.create_publisher(near if source is here else far, STRING)
        await until(lambda p=publisher: p.subscribers == 1)
        publisher.publish(sample(near))
        await inbox.wait(1)


@pytest.mark.parametrize("operation", ["publish", "subscribe"])
async def test_latched(world: World, operation: str) -> None:
    """A latched message reaches those who come late on the other network, once each."""
    cloud = await world.gateway("cloud", [])
    here, there = await world.robot("robot"), await world.robot("cloud")
    source, sink = (here, there) if operation == "publish" else (there, here)
    publisher = await source.create_publisher("/map", STRING, LATCHED)
    publisher.publish(sample("the map"))
    await world.gateway("robot", [{"address": url(cloud), operation: [item("/map")]}])
    await until(lambda: "/map" in sink.topics())
    for _ in range(2):
        inbox = Inbox()
        await sink.create_subscription("/map", STRING, LATCHED, inbox)
        await inbox.wait(1)
        await asyncio.sleep(0.1)
        assert inbox.payloads == [text("the map")]
    publisher.publish(sample("a new map"))
    await inbox.wait(2)


@pytest.mark.parametrize("operation", ["publish", "subscribe"])
async def test_latched_by_several(world: World, operation: str) -> None:
    """Who comes late gets what each of several publishers of the other network has latched (/tf_static)."""
    cloud = await world.gateway("cloud", [])
    here, there = await world.robot("robot"), await world.robot("cloud")
    source, sink = (here, there) if operation == "publish" else (there, here)
    await world.gateway("robot", [{"address": url(cloud), operation: [item("/tf_static")]}])
    await until(lambda: "/tf_static" in sink.topics())
    early = Inbox()
    await sink.create_subscription("/tf_static", STRING, QoS(durability="transient_local", depth=100), early)
    wanted = [text(name * 100_000) for name in ("a", "b", "c")]
    publishers = []
    for number, name in enumerate(("a", "b", "c"), 1):
        publishers.append(await source.create_publisher("/tf_static", STRING, LATCHED))
        publishers[-1].publish(sample(name * 100_000))
        await early.wait(number)
    await until(lambda: set(early.payloads) == set(wanted))
    await until(lambda: [p.qos.depth for p in sink.topics()["/tf_static"].publishers] == [3])
    for _ in range(2):
        late = Inbox()
        await sink.create_subscription("/tf_static", STRING, QoS(durability="transient_local", depth=100), late)
        await late.wait(3)
        await asyncio.sleep(0.1)
        assert sorted(late.payloads) == wanted
        await publishers[0].close()  # a publisher that leaves takes nothing away


async def test_best_effort(world: World) -> None:
    """A best-effort publisher is matched, and its topic is best effort on the other side."""
    cloud = await world.gateway("cloud", [])
    await world.gateway("robot", [{"address": url(cloud), "publish": [item("/scan")]}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    sensor = QoS(reliability="best_effort")
    publisher = await here.create_publisher("/scan", STRING, sensor)
    inbox = Inbox()
    await there.create_subscription("/scan", STRING, sensor, inbox)
    await until(lambda: publisher.subscribers == 1)
    await until(lambda: [p.qos.reliable for p in there.topics()["/scan"].publishers] == [False])
    publisher.publish(sample("1"))
    await inbox.wait(1)


async def test_both_ways(world: World) -> None:
    """A topic forwarded and fetched at once neither echoes nor loops."""
    cloud = await world.gateway("cloud", [])
    await world.gateway("robot", [{"address": url(cloud), "publish": [item("/x")], "subscribe": [item("/x")]}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    near, far = Inbox(), Inbox()
    await here.create_subscription("/x", STRING, QoS(), near)
    await there.create_subscription("/x", STRING, QoS(), far)
    p_here = await here.create_publisher("/x", STRING)
    p_there = await there.create_publisher("/x", STRING)
    await until(lambda: p_here.subscribers and p_there.subscribers)
    await asyncio.sleep(0.1)
    p_here.publish(sample("from here"))
    p_there.publish(sample("from there"))
    await far.wait(1)
    await near.wait(1)
    await asyncio.sleep(0.2)
    assert near.payloads == [text("from there")]
    assert far.payloads == [text("from here")]


async def test_two_links(world: World) -> None:
    """Two gateways of one network that forward the same topic give every message once."""
    cloud = await world.gateway("cloud", [])
    routes = [{"address": url(cloud), "publish": [item("/x")]}]
    await world.gateway("robot", routes)
    await world.gateway("robot", routes)
    here, there = await world.robot("robot"), await world.robot("cloud")
    inbox = Inbox()
    await there.create_subscription("/x", STRING, QoS(), inbox)
    publisher = await here.create_publisher("/x", STRING)
    await until(lambda: publisher.subscribers == 2)
    for i in range(10):
        publisher.publish(sample(str(i)))
    await inbox.wait(10)
    await asyncio.sleep(0.2)
    assert sorted(inbox.payloads) == [text(str(i)) for i in range(10)]
    assert sum(g["duplicates"] for g in cloud.status()["graphs"]) == 10


async def test_ring(world: World) -> None:
    """Three gateways in a ring pass a message round once."""
    a = await world.gateway("a", [])
    b = await world.gateway("b", [{"address": url(a), "publish": [item("/x")]}])
    c = await world.gateway("c", [{"address": url(b), "publish": [item("/x")]}])
    await world.gateway("a", [{"address": url(c), "publish": [item("/x")]}])
    inboxes = {}
    for name in "abc":
        robot = await world.robot(name)
        inboxes[name] = Inbox()
        await robot.create_subscription("/x", STRING, QoS(), inboxes[name])
    source = await world.robot("a")
    publisher = await source.create_publisher("/x", STRING)
    await until(lambda: (publisher.subscribers or 0) >= 2)
    await asyncio.sleep(0.3)
    publisher.publish(sample("round"))
    for inbox in inboxes.values():
        await inbox.wait(1)
    await asyncio.sleep(0.3)
    assert {name: len(inbox.samples) for name, inbox in inboxes.items()} == {"a": 1, "b": 1, "c": 1}


async def test_two_robots_meet(world: World) -> None:
    """Two robots that dial in to one gateway hear each other through it."""
    cloud = await world.gateway("cloud", [])
    for name in ("r1", "r2"):
        other = "r2" if name == "r1" else "r1"
        await world.gateway(
            name, [{"address": url(cloud), "publish": [item(f"/{name}/pose")], "subscribe": [item(f"/{other}/pose")]}]
        )
    r1, r2 = await world.robot("r1"), await world.robot("r2")
    inbox = Inbox()
    await r2.create_subscription("/r1/pose", STRING, QoS(), inbox)
    publisher = await r1.create_publisher("/r1/pose", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("here I am"))
    await inbox.wait(1)


async def test_the_remote_comes_late_and_returns(world: World) -> None:
    """A gateway waits for its remote, and everything works again after the remote was away."""
    async with AsyncExitStack() as first:
        probe = World(first)
        cloud = await probe.gateway("probe", [])
        port = cloud.servers[0].listeners[0].port
    robot = await world.gateway("robot", [{"address": f"ws://127.0.0.1:{port}", "publish": [item("/x")]}])
    here = await world.robot("robot")
    publisher = await here.create_publisher("/x", STRING)
    there = await world.robot("cloud")
    for _ in range(2):
        inbox = Inbox()
        subscription = await there.create_subscription("/x", STRING, QoS(), inbox)
        async with AsyncExitStack() as stack:
            again = World(stack)
            again.number = world.number
            await again.gateway("cloud", [], port=port)
            await until(lambda: robot.status()["routes"][0]["state"] == "active")
            publisher.publish(sample("hello"))
            await inbox.wait(1)
        await subscription.close()
        await until(lambda: robot.status()["remotes"][0]["state"] != "connected")
    assert robot.status()["remotes"][0]["connections"] == 2


async def test_status(world: World) -> None:
    """The status tells every route's state, rate and drops, and every client."""
    cloud = await world.gateway("cloud", [])
    robot = await world.gateway("robot", [{"address": url(cloud), "publish": [item("/x")]}])
    there = await world.robot("cloud")
    await there.create_subscription("/x", STRING, QoS(), lambda _: None)
    await until(lambda: robot.status()["routes"][0]["state"] == "active")
    (route,) = robot.status()["routes"]
    assert (route["path"], route["name"], route["type"]) == ("remotes[0].publish[0]", "/x", STRING)
    (session,) = cloud.status()["sessions"]
    assert session["gateway"] == "robot"
    assert session["topics"][0]["name"] == "/x"
    assert cloud.status()["listen"][0]["clients"] == 1


async def test_type_conflict(world: World) -> None:
    """A topic that exists with another type is refused with both types named, and nothing else suffers."""
    cloud = await world.gateway("cloud", [])
    there = await world.robot("cloud")
    await there.create_publisher("/x", "std_msgs/msg/Int32")
    robot = await world.gateway("robot", [{"address": url(cloud), "publish": [item("/x"), item("/y")]}])
    here = await world.robot("robot")
    await until(lambda: "std_msgs/msg/Int32" in robot.status()["routes"][0]["error"])
    inbox = Inbox()
    await there.create_subscription("/y", STRING, QoS(), inbox)
    publisher = await here.create_publisher("/y", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("fine"))
    await inbox.wait(1)


async def test_big_messages(world: World) -> None:
    """A message of 13 MB and one of 60 MB arrive whole; one above the limit is refused and the link lives on."""
    cloud = await world.gateway("cloud", [])
    await world.gateway("robot", [{"address": url(cloud), "publish": [item("/cloud", compression="cbor-raw")]}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    inbox = Inbox()
    await there.create_subscription("/cloud", STRING, QoS(), inbox)
    publisher = await here.create_publisher("/cloud", STRING)
    await until(lambda: publisher.subscribers == 1)
    for number, size in enumerate((13_000_000, 60_000_000), 1):
        big = Sample(text("x" * size), STRING, 1, bytes(16), 0)
        publisher.publish(big)
        await inbox.wait(number, 20)
        assert inbox.samples[-1].payload == big.payload
    publisher.publish(Sample(text("x" * 70_000_000), STRING, 1, bytes(16), 0))
    await until(lambda: cloud.status()["sessions"][0]["complaints"])
    publisher.publish(sample("small"))
    await inbox.wait(3)
    assert inbox.payloads[-1] == text("small")


async def test_delays_of_what_clients_publish(world: World) -> None:
    """A gateway that is dialled counts the delays of what the others publish on it, by topic."""
    cloud = await world.gateway("cloud", [])
    await world.gateway("robot", [{"address": url(cloud), "publish": [item("/odom")]}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    inbox = Inbox()
    await there.create_subscription("/odom", STRING, QoS(), inbox)
    publisher = await here.create_publisher("/odom", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(Sample(text("here"), STRING, 2, bytes(16), 1, sent_ns=1))
    await inbox.wait(1)
    told = cloud.status()["graphs"][0]["client_delays"]["published"]
    assert sum(told["/odom"]["counts"]) == 1
