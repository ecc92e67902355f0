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
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
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


async def profiles_of(robot: Robot) -> list[list[dict[str, Any]]]:
    """Return a list to which the rows of each profile that is published are added."""
    got: list[list[dict[str, Any]]] = []

    def came(batch: Sequence[Sample]) -> None:
        got.extend(REGISTRY.codec(DIAGNOSTICS).decode(sample.payload)["status"] for sample in batch)

    await robot.node.create_subscription("/robot/anycast/profile", DIAGNOSTICS, None, came)
    return got


async def test_the_profile_is_a_topic(world: World) -> None:
    """The profile is published as diagnostics: a row per member, with its statistics and its name in the policy."""
    robot, _ = await started(world)
    got = await profiles_of(robot)
    await until(lambda: got and any(pair["key"] == "median" for row in got[-1] for pair in row["values"]))
    used, other = ({pair["key"]: pair["value"] for pair in row["values"]} for row in got[-1])
    assert [row["message"].partition(",")[0] for row in got[-1]] == ["in use", "standby"]
    assert {"median", "p99", "in_flight"} <= used.keys()
    assert (used["machine"], other["machine"]) == ("m0", "m1")


async def test_the_profile_is_no_old_one(world: World) -> None:
    """Who reads the profile late gets a new one, though nobody read it before."""
    robot, edges = await started(world)
    await until(lambda: robot.group["current"] == url(edges[0].gateway))
    await trigger(robot, "switch_to/m1")
    late = await profiles_of(robot)
    await until(lambda: late and late[-1][1]["message"].startswith("in use"))
    later = await profiles_of(robot)
    await until(lambda: later)
    assert later[0][1]["message"].startswith("in use")


async def test_all_members_gone(world: World) -> None:
    """While no member is there the profile says gone, and what cannot be done is answered at once with the reason."""
    robot, edges = await started(world)
    for edge in edges:
        await edge.gateway.__aexit__(None, None, None)
    await until(lambda: not robot.group["current"])
    for name in ("optimise", "switch_to/m1"):
        answer = await trigger(robot, name)
        assert not answer["success"] and "no member is there" in answer["message"]
    paused = await call(robot, "pause", "std_srvs/srv/SetBool", {"data": True})
    assert paused["message"] == "nobody is in use; who comes first is kept"
    got = await profiles_of(robot)
    await until(lambda: got and all(row["message"].startswith("gone") for row in got[-1]))
