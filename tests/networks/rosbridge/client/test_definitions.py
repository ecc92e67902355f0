"""Definitions that nobody here has, asked from the server at the other end of a link."""

from __future__ import annotations

import asyncio
import json
from contextlib import AsyncExitStack

import pytest

from ropeway.graph.base import Sample, new_origin
from ropeway.hub.hub import Hub
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.client import RosbridgeGraph
from ropeway.networks.rosbridge.server import RosbridgeServer
from ropeway.types import TypeRegistry
from tests.support.rosbridge import FakeServer
from tests.support.until import until

ARM = "my_msgs/msg/Arm"
OWN = {
    "my_msgs/msg/Part": "string<=20 name\n",
    ARM: "uint8 IDLE=0\nuint8 state\nfloat64[3] at\nbyte[] raw\nPart[<=4] parts\n",
    "my_msgs/srv/Grasp": "Part part\n---\nbool done\n",
    "my_msgs/action/Move": "Part[] parts\n---\nbool done\n---\nfloat32 left\n",
}


def owner() -> TypeRegistry:
    found = TypeRegistry()
    for name, text in OWN.items():
        found.add_text(name, text)
    return found


@pytest.fixture
async def far(stack: AsyncExitStack) -> tuple[str, MemoryGraph]:
    """A server that has definitions of its own, and another participant of its network."""
    near, other = MemoryGraph("definitions", node="/far"), MemoryGraph("definitions", node="/robot")
    for graph in (near, other):
        await graph.open()
        stack.push_async_callback(graph.close)
    server = RosbridgeServer(Hub(near), owner(), gateway_id="far", name="far")
    stack.push_async_callback(server.close)
    listener = await server.listen("ws://127.0.0.1:0")
    return f"ws://127.0.0.1:{listener.port}", other


async def join(stack: AsyncExitStack, url: str, *, plain: bool) -> RosbridgeGraph:
    graph = RosbridgeGraph(url, registry=TypeRegistry(), plain=plain, ask_rosapi=False, watch=False)
    await graph.open()
    stack.push_async_callback(graph.close)
    return graph


@pytest.mark.parametrize("plain", [True, False])
async def test_what_a_server_knows(stack: AsyncExitStack, far: tuple[str, MemoryGraph], plain: bool) -> None:
    """Messages, services and actions of the server's own packages are learnt; a gateway tells their bounds, too."""
    graph = await join(stack, far[0], plain=plain)
    for name in OWN:
        assert await graph.learn(name)
        for part in graph.registry.roots(name):
            assert graph.registry.definition(part).same_layout(owner().definition(part))
        assert plain or graph.registry.hash(name) == owner().hash(name)
    assert not await graph.learn("my_msgs/msg/None")
    assert not await graph.learn("my_msgs/msg/None")


@pytest.mark.parametrize("plain", [True, False])
async def test_the_type_of_a_topic(stack: AsyncExitStack, far: tuple[str, MemoryGraph], plain: bool) -> None:
    """The type of a topic that is read over the link is learnt by itself, so that its messages are JSON for others."""
    graph = await join(stack, far[0], plain=plain)
    got: list[Sample] = []
    await graph.create_subscription("/arm", ARM, None, got.extend)
    await until(lambda: graph.registry.has(ARM))
    payload = owner().codec(ARM).encode({"state": 7, "parts": [{"name": "hand"}]})
    publisher = await far[1].create_publisher("/arm", ARM)
    await until(lambda: publisher.subscribers)
    publisher.publish(Sample(payload, ARM, 0, new_origin(), 1))
    await until(lambda: got)
    assert json.loads(graph.registry.codec(ARM).json(got[0].payload))["parts"] == [{"name": "hand"}]


async def test_what_is_told_wrongly(stack: AsyncExitStack, fake: FakeServer) -> None:
    """An answer of rosapi that is no definition leaves the type unknown, and costs the link nothing."""
    graph = await join(stack, fake.url, plain=True)
    types = [f"my_msgs/msg/T{number}" for number in range(6)]
    answers = [
        {"typedefs": []},
        {"typedefs": 5},
        {"typedefs": [{"type": types[2]}]},
        {"typedefs": [{"type": types[3], "fieldnames": ["a"], "fieldtypes": ["builtin/str"], "fieldarraylen": [-1]}]},
        {"typedefs": [{"type": types[4], "fieldnames": ["a"], "fieldtypes": ["no type"], "fieldarraylen": [-1]}]},
        {"typedefs": [{"type": types[5], "fieldnames": ["a"], "fieldtypes": ["int8"], "fieldarraylen": ["x"]}]},
    ]
    for type, answer in zip(types, answers, strict=True):
        asked = len(fake.ops("call_service"))
        task = asyncio.create_task(graph.learn(type))
        await until(lambda asked=asked: len(fake.ops("call_service")) > asked)
        call = fake.ops("call_service")[-1]
        assert call["service"] == "/rosapi/message_details"
        reply = {"op": "service_response", "id": call["id"], "service": call["service"]}
        fake.say({**reply, "values": answer, "result": True})
        assert not await task
