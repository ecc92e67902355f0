"""ropeway.gateway.group: a robot with several machines at addresses of their own, over real WebSockets."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config import config
from ropeway.graph.base import Sample
from ropeway.graph.calls import Request
from ropeway.group.graph import Group
from ropeway.networks import open_graph
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry
from tests.support.services import ADD, addends, total
from tests.support.until import until
from tests.support.world import World, url

FRAME = "sensor_msgs/msg/CompressedImage"
FOUND = "geometry_msgs/msg/PointStamped"
REGISTRY = TypeRegistry()


def frame(number: int) -> Sample:
    stamp = {"sec": 1 + number, "nanosec": 7}
    payload = REGISTRY.codec(FRAME).encode({"header": {"stamp": stamp}, "format": "jpeg", "data": bytes(100)})
    return Sample(payload, FRAME, 1 + number, bytes(16), 1 + number)


class Edge:
    """A machine that finds something in every frame, behind a gateway of its own."""

    def __init__(self, name: str, world: World) -> None:
        self.name, self.world = name, world
        self.frames: list[int] = []
        self.calls = 0

    async def start(self) -> None:
        self.gateway = await self.world.gateway(self.name, [])
        self.node: MemoryGraph = await self.world.robot(self.name)
        self.output = await self.node.create_publisher("/found", FOUND)
        await self.node.create_subscription("/camera", FRAME, None, self._look)
        await self.node.create_service("/add", ADD, self._add)

    def _look(self, batch: Sequence[Sample]) -> None:
        for sample in batch:
            stamp = REGISTRY.codec(FRAME).decode(sample.payload)["header"]["stamp"]
            self.frames.append(stamp["sec"])
            point = REGISTRY.codec(FOUND).encode({"header": {"stamp": stamp, "frame_id": self.name}})
            self.output.publish(Sample(point, FOUND, stamp["sec"], self.name.encode().ljust(16, b"_"), stamp["sec"]))

    async def _add(self, request: Request) -> bytes:
        self.calls += 1
        return total(self.calls)


class Robot:
    """A robot whose gateway has the edges as a group."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.found: list[tuple[int, str]] = []

    async def start(self, edges: Sequence[Edge], *, barred: int = 0, **anycast: Any) -> None:
        remote = {
            "address": [url(edge.gateway) for edge in edges],
            "anycast": {"responses": {"camera": "found"}, "latency_bound": {"median": 0.3}} | anycast,
            "publish": [{"name": "camera", "type": FRAME}],
            "subscribe": [{"name": "found", "type": FOUND}],
            "reserve-service": [{"name": "add", "type": ADD}],
        }
        self.gateway = await self.world.gateway("robot", [remote])
        self.node = await self.world.robot("robot")
        self.camera = await self.node.create_publisher("/camera", FRAME)
        await self.node.create_subscription("/found", FOUND, None, self._came)
        self.client = await self.node.create_client("/add", ADD)
        await until(
            lambda: (
                len(self.group["members"]) == len(edges)
                and sum(member["here"] for member in self.group["members"].values()) == len(edges) - barred
            )
        )
        await until(lambda: self.route("camera")["state"] == "active")
        await until(lambda: (self.camera.subscribers or 0) > 0)
        assert await self.client.wait_available(10)

    def _came(self, batch: Sequence[Sample]) -> None:
        for sample in batch:
            header = REGISTRY.codec(FOUND).decode(sample.payload)["header"]
            self.found.append((header["stamp"]["sec"], header["frame_id"]))

    @property
    def group(self) -> dict[str, Any]:
        found: dict[str, Any] = self.gateway.status()["remotes"][0]["group"]
        return found

    def route(self, name: str) -> dict[str, Any]:
        return next(row for row in self.gateway.status()["routes"] if row["name"] == f"/{name}")

    async def ask(self, first: int, count: int) -> None:
        """Publish frames, each when the one before was answered."""
        for number in range(first, first + count):
            self.camera.publish(frame(number))
            await until(lambda number=number: any(stamp == number + 1 for stamp, _ in self.found))


@pytest.fixture
async def world() -> AsyncIterator[World]:
    async with AsyncExitStack() as stack:
        yield World(stack)


async def edges_of(world: World, *names: str) -> list[Edge]:
    edges = [Edge(name, world) for name in names]
    for edge in edges:
        await edge.start()
    return edges


async def test_exactly_one(world: World) -> None:
    """Of three machines that offer the same, one gets each frame and answers it, and one carries out each call."""
    edges = await edges_of(world, "edge1", "edge2", "cloud")
    robot = Robot(world)
    await robot.start(edges)
    await robot.ask(0, 30)
    for _ in range(10):
        await robot.client.call(Request(addends(1)))
    assert sorted(number for edge in edges for number in edge.frames) == list(range(1, 31))
    assert [number for number, _ in robot.found] == list(range(1, 31))
    assert sum(edge.calls for edge in edges) == 10
    assert robot.group["paired"] == {"/found": {"equal header stamp": 30}}


async def test_a_machine_is_killed(world: World) -> None:
    """When the machine in use is gone, the next frame and the next call are answered by another."""
    edges = await edges_of(world, "edge1", "edge2")
    robot = Robot(world)
    await robot.start(edges)
    await robot.ask(0, 20)
    current = robot.group["current"]
    gone = next(edge for edge in edges if url(edge.gateway) == current)
    for session in list(gone.gateway.servers[0].sessions):
        session.peer.connection.abort("killed")
    await gone.gateway.servers[0].close()
    await until(lambda: robot.group["current"] != current)
    await robot.ask(20, 10)
    await robot.client.call(Request(addends(1)))
    other = next(edge for edge in edges if edge is not gone)
    assert other.frames[-10:] == list(range(21, 31))
    assert other.calls == 1
    assert len(robot.found) == 30
    state = robot.gateway.status()["remotes"][0]
    assert state["state"] == "connected"
    assert {member["address"]: member["state"] for member in state["members"]}[current] != "connected"


async def test_all_of_them(world: World) -> None:
    """With policy all every machine gets each frame, and each is answered once."""
    edges = await edges_of(world, "edge1", "edge2")
    robot = Robot(world)
    await robot.start(edges, policy="all", stateless=True)
    await robot.ask(0, 10)
    await until(lambda: all(edge.frames == list(range(1, 11)) for edge in edges))
    assert len(robot.found) == 10


async def test_latencies_of_a_topic(world: World) -> None:
    """A topic that tells latencies decides like those that are measured."""
    edges = await edges_of(world, "edge1", "edge2")
    robot = Robot(world)
    await robot.start(edges, latency_topic="/latency")
    before = robot.group["current"]
    told = await robot.node.create_publisher("/latency", "std_msgs/msg/Float64")
    await until(lambda: (told.subscribers or 0) > 0)
    late = REGISTRY.codec("std_msgs/msg/Float64").encode({"data": 0.9})

    def tell_and_ask() -> bool:
        number = len(robot.found)
        told.publish(Sample(late, "std_msgs/msg/Float64", 1, bytes(16), 1000 + number))
        robot.camera.publish(frame(number))
        return bool(robot.group["current"] != before)

    await until(tell_and_ask)


CAMERA, OUTPUT, ADDING = (
    {"name": "camera", "type": FRAME},
    {"name": "found", "type": FOUND},
    {"name": "add", "type": ADD},
)


@pytest.mark.parametrize(
    "change",
    [
        {"publish": [CAMERA | {"active": False}]},
        {"subscribe": [OUTPUT | {"active": False}]},
        {"reserve-service": [ADDING | {"active": False}]},
        {"publish": [CAMERA | {"priority": "command"}]},
        {"subscribe": [OUTPUT | {"depth": 50}]},
        {"reserve-service": [ADDING | {"timeout_s": 3.0}]},
        {"publish": [CAMERA, {"name": "more", "type": FOUND}]},
        {"subscribe": []},
        {"subscribe": [OUTPUT | {"remote_name": "/elsewhere"}]},
        {"publish": [], "subscribe": [], "reserve-service": []},
    ],
    ids=str,
)
async def test_one_route_changes(world: World, change: dict[str, Any]) -> None:
    """A route of a group comes, goes, pauses or changes: members, scheduler and the other routes never notice."""
    edges = await edges_of(world, "edge1", "edge2")
    robot = Robot(world)
    await robot.start(edges, latency_bound={"median": 30.0})  # of a busy machine nothing is late
    await robot.ask(0, 30)
    before = robot.gateway.config
    remote = before.to_json()["remotes"][0]
    if not any(change.values()):
        change = {key: [item | {"active": False} for item in remote[key]] for key in change}
    group, bridges = robot.gateway.remotes[0].graph, {r.route.key: r.bridge for r in robot.gateway.remotes[0].joined()}
    assert isinstance(group, Group)
    sessions = [session for edge in edges for session in edge.gateway.servers[0].sessions]
    decided, windows = group.scheduler.decided, {name: group.scheduler.window(name) for name in group.scheduler.here}
    changed = config.parse({"gateway": before.to_json()["gateway"], "remotes": [remote | change]})
    for wanted in (changed, before):
        await robot.gateway.apply(wanted)
        for number in range(5):
            robot.camera.publish(frame(100 + number))
        assert robot.gateway.remotes[0].graph is group
        untouched = {route.key for route in before.routes()} & {route.key for route in changed.routes()}
        kept = {r.route.key: r.bridge for r in robot.gateway.remotes[0].joined() if r.route.kind == "topic"}
        assert all(bridge is bridges[key] for key, bridge in kept.items() if key in untouched)
    await until(lambda: robot.route("camera")["state"] == robot.route("found")["state"] == "active")
    await until(lambda: (robot.camera.subscribers or 0) > 0)
    numbers = itertools.count(200)

    def crosses() -> bool:
        robot.camera.publish(frame(next(numbers)))
        return bool(robot.found and robot.found[-1][0] > 200)

    await until(crosses)
    await robot.ask(next(numbers), 5)
    assert await robot.client.wait_available(10)
    await robot.client.call(Request(addends(1)))
    assert [session for edge in edges for session in edge.gateway.servers[0].sessions] == sessions
    assert {name: group.scheduler.window(name) for name in group.scheduler.here} == windows
    assert group.scheduler.decided == decided and group.scheduler.phase.name == "STEADY"


async def test_answers_that_nobody_reads(world: World) -> None:
    """While the route of the answers is paused requests go on, and tell nothing of the machine that gets them."""
    edges = await edges_of(world, "edge1", "edge2")
    robot = Robot(world)
    await robot.start(edges, latency_bound={"median": 30.0})  # of a busy machine nothing is late
    await robot.ask(0, 30)
    document = robot.gateway.config.to_json()
    document["remotes"][0]["subscribe"][0]["active"] = False
    await robot.gateway.apply(config.parse(document))
    decisions, current = robot.group["decisions"], robot.group["current"]
    for number in range(30, 60):
        robot.camera.publish(frame(number))
    used = next(edge for edge in edges if url(edge.gateway) == current)
    await until(lambda: used.frames[-30:] == list(range(31, 61)))
    assert robot.group["members"][current]["in_flight"] == 0
    assert robot.group["decisions"] == decisions


@pytest.mark.parametrize(
    ("remote", "path", "words"),
    [
        ({"address": ["ws://a", "iort://b"]}, "remotes[0].address[1]", "only ws:// and wss:// addresses"),
        ({"address": ["ws://a", "wss://b"]}, "remotes[0].address[1]", "all are wss://"),
        ({"address": ["ws://a", "ws://a:9090"]}, "remotes[0].address[1]", "the same address as 0"),
        ({"address": []}, "remotes[0].address", "a list of up to 64"),
        ({"address": ["ws://a", 5]}, "remotes[0].address[1]", "expected a text, got 5"),
        ({"address": "ws://a", "anycast": {}}, "remotes[0].anycast", "needs several addresses"),
        (
            {"address": ["ws://a", "ws://b"], "anycast": {"policy": "hedge"}},
            "remotes[0].anycast.policy",
            'write "stateless": true',
        ),
        (
            {"address": ["ws://a", "ws://b"], "anycast": {"latency_bound": {"medain": 0.3}}},
            "remotes[0].anycast.latency_bound.medain",
            'did you mean "median"?',
        ),
        (
            {"address": ["ws://a", "ws://b"], "anycast": {"latency_bound": {"median": -1}}},
            "remotes[0].anycast.latency_bound.median",
            "above 0",
        ),
        (
            {"address": ["ws://a", "ws://b"], "anycast": {"responses": {"camera": "a b"}}},
            "remotes[0].anycast.responses.camera",
            "expected names of topics",
        ),
    ],
)
def test_mistakes(remote: dict[str, Any], path: str, words: str) -> None:
    """A group that cannot be meant is refused with the path of the mistake and what to write."""
    with pytest.raises(ConfigError) as caught:
        config.parse([remote])
    assert any(where == path and words in text for where, text in caught.value.problems), caught.value.problems


def test_workers_get_the_whole_group() -> None:
    """A group survives the way to a worker and back."""
    made = config.parse(
        [{"address": ["ws://a", "ws://b"], "anycast": {"stateless": True, "latency_bound": {"p99": 0.3}}}]
    )
    again = config.parse(made.to_json())
    assert again.remotes == made.remotes
    assert again.remotes[0].addresses == ("ws://a:9090", "ws://b:9090")


async def test_on_the_command_line(world: World) -> None:
    """A group is written with commas wherever a graph is named, and is called like any graph."""
    edges = await edges_of(world, "edge1", "edge2")
    graph = await open_graph(",".join(url(edge.gateway) for edge in edges))
    world.stack.push_async_callback(graph.close)
    client = await graph.create_client("/add", ADD)
    assert await client.wait_available(10)
    for _ in range(4):
        await client.call(Request(addends(1)))
    assert sum(edge.calls for edge in edges) == 4
