"""Topics of a gateway are looked at and published on by people."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from ropeway.errors import CallFailed, RopewayError
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.limits import LOOKED_AT_TOPICS
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.until import until
from tests.support.world import World

STRING, TWIST = "std_msgs/msg/String", "geometry_msgs/msg/Twist"
REGISTRY = TypeRegistry()


def sample(type: str, value: dict[str, Any]) -> Sample:
    return Sample(REGISTRY.codec(type).from_json(value), type, 1, new_origin(), SEQ_NONE)


async def looked(gateway: Gateway, topic: str, count: int) -> dict[str, Any]:
    """What is told of a topic once so many messages have come."""
    while (found := await gateway.looks.look(topic))["count"] < count:
        await asyncio.sleep(0.01)
    return found


async def test_a_topic_is_listed_and_looked_at(world: World) -> None:
    """A topic is listed, its newest message comes once, and the topic is left when nobody asks any more."""
    gateway, robot = await world.gateway("robot", []), await world.robot("robot")
    publisher = await robot.create_publisher("/chatter", STRING)
    (listed,) = [topic for topic in gateway.looks.listed() if topic["name"] == "/chatter"]
    assert (listed["type"], listed["publishers"]) == (STRING, 1)
    assert "value" not in await gateway.looks.look("/chatter")
    await until(lambda: publisher.subscribers)
    publisher.publish(sample(STRING, {"data": "old"}))
    publisher.publish(sample(STRING, {"data": "new"}))
    found = await looked(gateway, "/chatter", 2)
    assert found["value"] == {"data": "new"}
    assert "value" not in await gateway.looks.look("/chatter", after=2)
    await until(lambda: not publisher.subscribers)


async def test_a_topic_that_is_not_there(world: World) -> None:
    """A topic that nobody has, a network that is none, and a type that is not known are errors with a sentence."""
    gateway = await world.gateway("robot", [])
    with pytest.raises(CallFailed, match="nobody publishes it"):
        await gateway.looks.look("/nothing")
    with pytest.raises(CallFailed, match="the graphs here are"):
        await gateway.looks.look("/nothing", "dds:99")
    with pytest.raises(RopewayError):
        await gateway.looks.publish("/a", "no_such/msg/Type", {}, driver="d")
    with pytest.raises(RopewayError):
        await gateway.looks.publish("/a", TWIST, {"linear": 7}, driver="d")


async def test_messages_are_published(world: World) -> None:
    """A message arrives at the robot, and the topic is withdrawn when no more come."""
    gateway, robot = await world.gateway("robot", []), await world.robot("robot")
    inbox = Inbox()
    await robot.create_subscription("/cmd_vel", TWIST, None, inbox)
    done = await gateway.looks.publish("/cmd_vel", TWIST, {"linear": {"x": 0.5}}, driver="d")
    assert done == {"readers": 1}
    await inbox.wait(1)
    assert REGISTRY.codec(TWIST).decode(inbox.payloads[0])["linear"]["x"] == 0.5
    await until(lambda: not robot.topics()["/cmd_vel"].publishers)


async def test_a_lease_guards_what_is_published(world: World) -> None:
    """Commands pass the guard of their topic: they are cut to its limits, and the safe message ends them."""
    guard = [{"topic": "/cmd_vel", "type": TWIST, "lease_s": 0.2, "max": {"linear.x": 0.3}, "drivers": "first"}]
    gateway, robot = await world.gateway("robot", [], safety=guard), await world.robot("robot")
    inbox = Inbox()
    await robot.create_subscription("/cmd_vel", TWIST, None, inbox)
    await gateway.looks.publish("/cmd_vel", TWIST, {"linear": {"x": 9.0}}, driver="ann")
    await gateway.looks.publish("/cmd_vel", TWIST, {"linear": {"x": 0.1}}, driver="bob")
    await inbox.wait(2)
    speeds = [REGISTRY.codec(TWIST).decode(payload)["linear"]["x"] for payload in inbox.payloads[:2]]
    assert speeds == [0.3, 0.0]
    (status,) = gateway.status()["safety"]
    assert status["refused"] == {"another driver holds the lease": 1}


async def test_topics_in_use_are_bounded(world: World) -> None:
    """Whoever asks for one topic after the other gets no more than a number of them."""
    gateway = await world.gateway("robot", [])
    for number in range(LOOKED_AT_TOPICS):
        await gateway.looks.publish(f"/topic{number}", STRING, {"data": "x"}, driver="d")
    with pytest.raises(CallFailed, match="in use already"):
        await gateway.looks.publish("/one_more", STRING, {"data": "x"}, driver="d")


async def test_a_graph_that_is_gone(world: World) -> None:
    """A gateway that goes down leaves all topics."""
    robot: MemoryGraph = await world.robot("robot")
    publisher = await robot.create_publisher("/chatter", STRING)
    async with Gateway((await world.gateway("other", [])).config) as gateway:
        with pytest.raises(CallFailed):
            await gateway.looks.look("/chatter")
    assert not publisher.subscribers
