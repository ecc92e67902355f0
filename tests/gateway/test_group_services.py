"""ropeway.gateway.group_services: a group as nodes of the robot see it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.graph.base import Sample
from ropeway.graph.calls import Request
from ropeway.types import TypeRegistry
from tests.gateway.test_group import Edge, Robot, edges_of
from tests.support.until import until
from tests.support.world import World, url

REGISTRY = TypeRegistry()
POLICY = {"robot": "robot", "m0": "service", "m1": "standby"}


@pytest.fixture
async def world() -> AsyncIterator[World]:
    async with AsyncExitStack() as stack:
        yield World(stack)


async def call(robot: Robot, name: str, type: str, request: dict[str, Any]) -> dict[str, Any]:
    """Call a service of the robot's gateway."""
    client = await robot.node.create_client(f"/robot/anycast/{name}", type)
    assert await client.wait_available(10)
    answer = await client.call(Request(REGISTRY.codec(f"{type}_Request").encode(request)))
    found: dict[str, Any] = REGISTRY.codec(f"{type}_Response").decode(answer)
    await client.close()
    return found


async def trigger(robot: Robot, name: str) -> dict[str, Any]:
    """Call a service without a request."""
    return await call(robot, name, "std_srvs/srv/Trigger", {})


async def started(world: World) -> tuple[Robot, list[Edge]]:
    """Start two machines, and a robot that has used the first."""
    edges = await edges_of(world, "edge1", "edge2")
    robot = Robot(world)
    await robot.start(edges, initial_policy=POLICY, latency_bound={})
    await robot.ask(0, 3)
    return robot, edges


async def test_switch_by_hand(world: World) -> None:
    """A node switches by hand, by the name of the policy, and the next request goes there."""
    robot, edges = await started(world)
    answer = await trigger(robot, "switch_to/m1")
    assert answer["success"] and json.loads(answer["message"])["current"] == url(edges[1].gateway)
    await robot.ask(3, 2)
    assert edges[1].frames == [4, 5]


async def test_pause(world: World) -> None:
    """While it is paused the scheduler changes nothing, and tells so."""
    robot, _ = await started(world)
    assert (await call(robot, "pause", "std_srvs/srv/SetBool", {"data": True}))["success"]
    assert robot.group["held"]
    assert "judged again" in (await call(robot, "pause", "std_srvs/srv/SetBool", {"data": False}))["message"]
    assert not robot.group["held"]


async def test_profiles(world: World) -> None:
    """The list of profiles has the statistics and classes of each member, and nothing for one that was not asked."""
    robot, edges = await started(world)
    members = json.loads((await trigger(robot, "list_profiles"))["message"])["members"]
    used, other = (members[url(edge.gateway)] for edge in edges)
    assert used["latency_s"]["answered"] == 3 and used["classes"] and used["fit"] is not None
    assert other["latency_s"] is None and other["classes"] == [] and other["fit"] is None


async def test_optimise(world: World) -> None:
    """Optimising asks each member with the robot's own requests, and answers with the new profile."""
    robot, edges = await started(world)
    stop = False

    async def go_on() -> None:
        number = 3
        while not stop:
            await robot.ask(number, 1)
            number += 1

    asking = asyncio.create_task(go_on())
    answer = await trigger(robot, "optimise")
    stop = True
    await asking
    assert answer["success"], answer
    members = json.loads(answer["message"])["members"]
    assert all(members[url(edge.gateway)]["latency_s"] for edge in edges)


async def test_the_profile_is_a_topic(world: World) -> None:
    """The profile is published as diagnostics: a status per member, with its statistics as values."""
    robot, _ = await started(world)
    got: list[dict[str, Any]] = []
    type = "diagnostic_msgs/msg/DiagnosticArray"

    def came(batch: Sequence[Sample]) -> None:
        got.extend(REGISTRY.codec(type).decode(sample.payload) for sample in batch)

    await robot.node.create_subscription("/robot/anycast/profile", type, None, came)
    await until(lambda: got)
    status = got[-1]["status"]
    assert len(status) == 2
    used = next(row for row in status if row["message"].startswith("in use"))
    assert {"median", "p99", "in_flight"} <= {pair["key"] for pair in used["values"]}
