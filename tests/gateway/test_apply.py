"""ropeway.gateway.apply: a running gateway goes over to another configuration."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.errors import ConfigError, RopewayError
from ropeway.gateway.apply import ConfigChange
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.gateway.plan import make_plan
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.until import until

_numbers = itertools.count()


class World:
    """A cloud that listens and a robot that dials, each with a network of its own and a participant there."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack, self.number = stack, next(_numbers)

    async def start(self, *remotes: dict[str, Any]) -> None:
        self.cloud = await self.stack.enter_async_context(Gateway(self.made("cloud", listen=["ws://127.0.0.1:0"])))
        self.url = f"ws://127.0.0.1:{self.cloud.servers[0].listeners[0].port}"
        self.robot = await self.stack.enter_async_context(Gateway(self.made("robot", *remotes)))
        self.here, self.there = await self.participant("robot"), await self.participant("cloud")

    def made(self, name: str, *remotes: dict[str, Any], **settings: Any) -> config.Config:
        gateway = {"name": name, "graphs": [f"memory:apply-{name}-{self.number}"], "listen": [], **settings}
        filled = [{"address": getattr(self, "url", "ws://127.0.0.1:9"), **remote} for remote in remotes]
        return config.parse({"gateway": gateway, "remotes": filled})

    async def participant(self, name: str) -> MemoryGraph:
        graph = MemoryGraph(f"apply-{name}-{self.number}", node="/node")
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph

    async def apply(self, *remotes: dict[str, Any], **settings: Any) -> None:
        await self.robot.apply(self.made("robot", *remotes, **settings))


@pytest.fixture
async def world(stack: AsyncExitStack) -> AsyncIterator[World]:
    """A cloud and a robot without routes."""
    made = World(stack)
    await made.start()
    yield made


def item(name: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "type": STRING, **more}


def topics(*names: str) -> dict[str, Any]:
    return {"publish": [item(name) for name in names]}


class Talk:
    """Publishes numbers as fast as the loop turns, and hears them at the other end."""

    def __init__(self, source: MemoryGraph, sink: MemoryGraph, topic: str) -> None:
        self.source, self.sink, self.topic = source, sink, topic
        self.sent = 0
        self.heard: list[int] = []
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        qos = QoS(depth=10_000)
        await self.sink.create_subscription(self.topic, STRING, qos, self._hear)
        publisher = await self.source.create_publisher(self.topic, STRING, qos)
        await until(lambda: publisher.subscribers)

        async def talk() -> None:
            while True:
                publisher.publish(Sample(text(str(self.sent)), STRING, 1, bytes(16), SEQ_NONE))
                self.sent += 1
                await asyncio.sleep(0.001)

        self._task = asyncio.create_task(talk())
        await until(lambda: len(self.heard) > 20)

    async def stop(self) -> None:
        assert self._task is not None
        self._task.cancel()
        await until(lambda: self.heard and self.heard[-1] == self.sent - 1)

    def _hear(self, batch: Any) -> None:
        self.heard += [int(bytes(message.payload[8:]).split(b"\0")[0]) for message in batch]


async def test_routes_come_and_go(world: World) -> None:
    """An added route carries messages, one that is taken away does not, and the others never notice."""
    await world.apply(topics("/kept", "/gone"))
    talk = Talk(world.here, world.there, "/kept")
    await talk.start()
    await world.apply(topics("/new", "/kept"))
    inbox = Inbox()
    await world.there.create_subscription("/new", STRING, QoS(), inbox)
    publisher = await world.here.create_publisher("/new", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("hello"))
    await inbox.wait(1)
    assert "/gone" not in world.there.topics()
    await talk.stop()
    assert talk.heard == list(range(talk.heard[0], talk.sent))
    rows = [(row.name, row.path) for row in world.robot.routes()]
    assert rows == [("/new", "remotes[0].publish[0]"), ("/kept", "remotes[0].publish[1]")]
    assert world.robot.remotes[0].status()["connections"] == 1


@pytest.mark.parametrize(
    "change",
    [{"compression": "zstd"}, {"priority": "command"}, {"depth": 20_000}, {"weight": 3.0}, {"rate_hz": 1e6}],
    ids=str,
)
@pytest.mark.parametrize("operation", ["publish", "subscribe"])
async def test_no_message_is_lost_in_a_change(world: World, operation: str, change: dict[str, Any]) -> None:
    """A route that is treated in another way hands over without a message that is lost or comes twice."""
    await world.apply({operation: [item("/n", depth=10_000)]})
    source, sink = (world.here, world.there) if operation == "publish" else (world.there, world.here)
    talk = Talk(source, sink, "/n")
    await talk.start()
    for options in (change, {}, change):
        await world.apply({operation: [item("/n", **{"depth": 10_000, **options})]})
        heard = len(talk.heard)
        await until(lambda h=heard: len(talk.heard) > h + 20)
    await talk.stop()
    assert talk.heard == list(range(talk.heard[0], talk.sent))


async def test_another_link(world: World) -> None:
    """Where the link itself changes, the new one is up before the old one goes: nothing is lost or comes twice."""
    remote = {"publish": [item("/n", depth=10_000)]}
    await world.apply(remote)
    talk = Talk(world.here, world.there, "/n")
    await talk.start()
    before = world.robot.remotes[0]
    await world.apply({**remote, "ros": 2})
    assert world.robot.remotes[0] is not before
    heard = len(talk.heard)
    await until(lambda: len(talk.heard) > heard + 20)
    await talk.stop()
    assert talk.heard == list(range(talk.heard[0], talk.sent))
    assert len(world.cloud.servers[0].sessions) == 1


async def test_discovery_is_begun_where_it_is_needed(world: World) -> None:
    """The first topic that is fetched over a link that only sent so far is found there."""
    await world.apply(topics("/out"))
    await until(lambda: world.robot.remotes[0].state == "connected")
    await world.apply({**topics("/out"), "subscribe": [item("/in")]})
    talk = Talk(world.there, world.here, "/in")
    await talk.start()
    await talk.stop()


async def test_pausing(world: World) -> None:
    """A paused route is in the table as paused, carries nothing, and goes on when it is active again."""
    await world.apply({"publish": [item("/a"), item("/b", active=False)]})
    assert {row.name: row.state for row in world.robot.routes()}["/b"] == "paused"
    assert "/b" not in world.there.topics()
    await world.apply(topics("/a", "/b"))
    await until(lambda: "/b" in world.there.topics())


async def test_everything_is_restored(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where one part cannot be started, nothing has changed, whatever was started before it."""
    await world.apply(topics("/a"))
    rows = [row.path for row in world.robot.routes()]
    bad = {"address": "wss://127.0.0.1:9", "token": {"env": "NOT_SET_ANYWHERE"}, **topics("/c")}
    with pytest.raises(ConfigError, match="NOT_SET_ANYWHERE"):
        await world.apply(topics("/a", "/b"), bad)
    opened = world.robot.open_remote

    async def fails(new: config.Config, index: int, routes: Any) -> Any:
        if index == 2:
            raise RopewayError("this one cannot be had")
        return await opened(new, index, routes)

    monkeypatch.setattr(world.robot, "open_remote", fails)
    with pytest.raises(RopewayError, match="cannot be had"):
        await world.apply(topics("/a", "/b"), {"ros": 2, **topics("/c")}, {"ros": 1, **topics("/d")})
    assert [row.path for row in world.robot.routes()] == rows
    assert len(world.robot.remotes) == 1
    await until(lambda: set(world.there.topics()) & {"/a", "/b", "/c", "/d"} == {"/a"})
    talk = Talk(world.here, world.there, "/a")
    await talk.start()
    await talk.stop()


async def test_a_swap_that_fails_is_undone(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a route cannot be changed, those changed before it are changed back, and nothing new stays."""
    await world.apply({"publish": [item("/a", rate_hz=1.0), item("/b")]})
    (running,) = world.robot.running
    changed = running.change

    async def fails(route: Any) -> None:
        if route.name == "/b" and route.options.delivery.rate_hz:
            raise RopewayError("not this one")
        await changed(route)

    monkeypatch.setattr(running, "change", fails)
    with pytest.raises(RopewayError, match="not this one"):
        await world.apply({"publish": [item("/a", rate_hz=2.0), item("/b", rate_hz=2.0), item("/c")]})
    routes = {row.route.name: row.route.options.delivery.rate_hz for row in world.robot.remotes[0].running.values()}
    assert routes == {"/a": 1.0, "/b": None}


async def test_two_phases(world: World) -> None:
    """What was prepared can be taken back, and nothing is left of it."""
    await world.apply(topics("/a"))
    change = ConfigChange(world.robot, make_plan(world.robot.config, world.made("robot", topics("/a", "/b"))))
    await change.prepare()
    await until(lambda: "/b" in world.there.topics())
    await change.abort()
    await until(lambda: "/b" not in world.there.topics())
    assert [row.name for row in world.robot.routes()] == ["/a"]


async def test_a_peer_that_is_away(world: World) -> None:
    """A change over to a peer that does not answer ends all the same, and says so in the state of the link."""
    await world.apply(topics("/a"))
    await until(lambda: world.robot.remotes[0].state == "connected")
    await world.apply({"address": "ws://127.0.0.1:9", **topics("/a")})
    assert world.robot.remotes[0].state != "connected"


async def test_what_needs_a_restart(world: World) -> None:
    """A change of the gateway itself takes everything down and up again; the routes are back."""
    await world.apply(topics("/a"))
    await world.apply(topics("/a"), max_message_bytes=1 << 20)
    assert world.robot.config.gateway.max_message_bytes == 1 << 20
    talk = Talk(world.here, world.there, "/a")
    await talk.start()
    await talk.stop()


async def test_a_restart_that_fails(world: World) -> None:
    """Where the new one does not come up, as its port is taken, the old one is brought up again."""
    await world.apply(topics("/a"))
    taken = world.url
    with pytest.raises(RopewayError, match="cannot listen"):
        await world.apply(topics("/a"), listen=[taken])
    assert world.robot.config.gateway.listen == ()
    talk = Talk(world.here, world.there, "/a")
    await talk.start()
    await talk.stop()


async def test_who_may_come_in(world: World) -> None:
    """Rules for clients are changed while everything goes on."""
    connections = world.cloud.servers[0].sessions
    new = world.made("cloud", listen=["ws://127.0.0.1:0"], globs={"topics": ["/only"]})
    await world.cloud.apply(new)
    assert world.cloud.servers[0].entrance.door.globs.topics_pub == ("/only",)
    assert world.cloud.servers[0].sessions is connections


@pytest.mark.parametrize("change", [{"compression": "zstd"}, {"qos": {"depth": 7}}], ids=str)
async def test_a_peer_that_vanishes_in_mid_swap(world: World, monkeypatch: pytest.MonkeyPatch, change: Any) -> None:
    """Where the peer goes while routes hand over, the change is made all the same, and works once the peer is back."""
    await world.apply(topics("/n"))
    talk = Talk(world.here, world.there, "/n")
    await talk.start()
    swap = ConfigChange._swap

    async def vanish(self: ConfigChange) -> None:
        for session in world.cloud.servers[0].sessions:
            session.peer.connection.abort("the peer vanished")
        await swap(self)

    monkeypatch.setattr(ConfigChange, "_swap", vanish)
    await world.apply({"publish": [item("/n", **change)]})
    assert [row.name for row in world.robot.routes()] == ["/n"]
    heard = len(talk.heard)
    await until(lambda: len(talk.heard) > heard + 10)
    assert world.robot.remotes[0].status()["connections"] == 2
