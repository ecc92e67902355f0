"""Verbs at a server that refuses what they need."""

from __future__ import annotations

from contextlib import AsyncExitStack

import pytest

from ropeway.cli.session import OpenGraph
from ropeway.cli.topic.echo import echo
from ropeway.cli.topic.pub import publish
from ropeway.cli.topic.watch import meter
from ropeway.cli.topic.window import Rate
from ropeway.errors import Refused
from ropeway.hub.hub import Hub
from ropeway.listener.authentication import Door, TokenRule
from ropeway.listener.authorization import EVERYTHING, Role
from ropeway.listener.entrance import Entrance
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.client import RosbridgeGraph
from ropeway.networks.rosbridge.server import RosbridgeServer
from ropeway.types import TypeRegistry
from tests.support.messages import STRING
from tests.support.until import until

pytestmark = pytest.mark.jumping


async def serve(stack: AsyncExitStack, registry: TypeRegistry, door: Door) -> RosbridgeServer:
    """A server with a network of its own."""
    graph = MemoryGraph(f"refusal-{id(stack)}")
    await graph.open()
    stack.push_async_callback(graph.close)
    server = RosbridgeServer(Hub(graph), registry, entrance=Entrance(door))
    stack.push_async_callback(server.close)
    await server.listen("ws://127.0.0.1:0")
    return server


async def join(stack: AsyncExitStack, server: RosbridgeServer, token: str = "") -> OpenGraph:
    """A verb's session at the server."""
    headers = {"Authorization": f"Bearer {token}"} if token else None
    graph = RosbridgeGraph(f"ws://127.0.0.1:{server.listeners[0].port}", registry=server.registry, headers=headers)
    await graph.open()
    stack.push_async_callback(graph.close)
    return OpenGraph(graph, server.registry)


async def test_a_topic_that_is_refused_ends_the_verb(stack: AsyncExitStack, registry: TypeRegistry) -> None:
    """Publishing, printing and measuring end at once with the rule that denies the topic."""
    session = await join(stack, await serve(stack, registry, Door(default=Role("guest", {"subscribe": ("/open",)}))))
    with pytest.raises(Refused, match=r"/odom was refused: .*role guest does not list it under publish"):
        await publish(session, "/odom", STRING, {}, times=1)
    with pytest.raises(Refused, match=r"/odom was refused: .*role guest does not list it under subscribe"):
        await echo(session, "/odom", STRING, None, lambda sample: "")
    with pytest.raises(Refused, match="role guest does not list it under subscribe"):
        await meter(session, "/odom", STRING, None, Rate())


async def test_what_is_published_once_arrives(stack: AsyncExitStack, registry: TypeRegistry) -> None:
    """One message that waits for no reader is sent once the server has taken the topic, and reaches who reads it."""
    server = await serve(stack, registry, Door(default=EVERYTHING))
    got: list[bytes] = []
    await server.hub.graph.create_subscription(
        "/odom", STRING, None, lambda batch: got.extend(sample.payload for sample in batch)
    )
    reader = server.hub.view("reader")
    await reader.create_subscription("/odom", STRING, None, lambda batch: got.extend(s.payload for s in batch))
    session = await join(stack, server)
    assert await publish(session, "/odom", STRING, {"data": "x"}, times=1) == 1
    await until(lambda: got)
    assert registry.codec(STRING).decode(got[0]) == {"data": "x"}


async def test_who_is_let_in_no_more_ends(stack: AsyncExitStack, registry: TypeRegistry) -> None:
    """A verb whose token is taken back ends with what the server says."""
    door = Door(tokens=(TokenRule.plain("secret", EVERYTHING),), default=None)
    server = await serve(stack, registry, door)
    session = await join(stack, server, "secret")
    server.entrance.door = Door(tokens=(TokenRule.plain("other", EVERYTHING),), default=None)
    server.recheck()
    with pytest.raises(Refused, match="answered HTTP 401"):
        await echo(session, "/odom", STRING, None, lambda sample: "")
