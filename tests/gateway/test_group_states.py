"""ropeway.gateway.group_states: machines are told their states, and enter them with their parameters."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import pytest

from tests.gateway.test_group import Edge, Robot, edges_of
from tests.graph.parameter_node import ParameterNode
from tests.support.until import until
from tests.support.world import World

STATES = {
    "standby": None,
    "service": {"params": [{"/gpu": "watts:=300"}]},
    "training": {"params": {"/gpu": {"watts": 90}}},
}


@pytest.fixture
async def world() -> AsyncIterator[World]:
    async with AsyncExitStack() as stack:
        yield World(stack)


def told(edge: Edge) -> str:
    """Return the state that a machine holds."""
    sessions = edge.gateway.status()["sessions"]
    return "".join(session.get("state", {}).get("state", "") for session in sessions)


def policy(*states: str) -> dict[str, Any]:
    """Return the initial policy of a robot and as many machines."""
    return {"robot": "robot", **{f"m{i}": state for i, state in enumerate(states)}}


async def test_the_policy_begins(world: World) -> None:
    """The machine in state service is used first, and each machine holds the state that it was told."""
    edges = await edges_of(world, "edge1", "edge2")
    robot = Robot(world)
    await robot.start(edges, initial_policy=policy("standby", "service"), latency_bound={})
    await robot.ask(0, 5)
    assert edges[1].frames and not edges[0].frames
    await until(lambda: [told(edge) for edge in edges] == ["standby", "service"])
    assert {name: row["state"] for name, row in robot.group["states"].items()} == {"m0": "standby", "m1": "service"}


async def test_parameters_are_set_on_entering(world: World) -> None:
    """Parameters of a state are set on the nodes of the machine that enters it, at the start and after a switch."""
    edges = await edges_of(world, "edge1", "edge2")
    nodes = [await ParameterNode({"watts": 10}).serve(edge.node, "/gpu") for edge in edges]
    robot = Robot(world)
    camera = await ParameterNode({"fps": 15}).serve(await world.robot("robot"), "/camera")
    await robot.start(
        edges,
        state_definition=STATES,
        params=[{"/camera": "fps:=30"}],
        initial_policy=policy("service", "standby"),
        latency_bound={},
    )
    await until(lambda: [node.values["watts"] for node in nodes] == [300, 10])
    await until(lambda: camera.values["fps"] == 30)
    group: Any = robot.gateway.remotes[0].graph
    group.scheduler.switch(list(group.members)[1], group.now())
    group.tell()
    await until(lambda: [node.values["watts"] for node in nodes] == [300, 300])
    await until(lambda: [told(edge) for edge in edges] == ["standby", "service"])


async def test_a_state_of_ones_own(world: World) -> None:
    """A machine in another state than service and standby is asked nothing, and has the parameters of that state."""
    edges = await edges_of(world, "edge1", "edge2")
    node = await ParameterNode({"watts": 10}).serve(edges[0].node, "/gpu")
    robot = Robot(world)
    await robot.start(edges, barred=1, state_definition=STATES, initial_policy=policy("training", "standby"))
    await until(lambda: node.values["watts"] == 90)
    await robot.ask(0, 10)
    assert not edges[0].frames
    await until(lambda: told(edges[0]) == "training")


async def test_a_node_that_is_not_there(world: World) -> None:
    """A parameter that cannot be set is told in the status with its node and the reason, and the machine serves."""
    edges = await edges_of(world, "edge1")
    edges += await edges_of(world, "edge2")
    robot = Robot(world)
    await robot.start(edges, state_definition=STATES, initial_policy=policy("service", "standby"), latency_bound={})
    await robot.ask(0, 3)
    await until(lambda: robot.group["states"]["m0"]["refused"], timeout_s=20)
    assert "/gpu watts" in robot.group["states"]["m0"]["refused"]


async def test_a_node_that_comes_later(world: World) -> None:
    """A node that was not there when its machine entered the state gets its parameters once it is."""
    edges = await edges_of(world, "edge1", "edge2")
    robot = Robot(world)
    await robot.start(edges, state_definition=STATES, initial_policy=policy("service", "standby"), latency_bound={})
    await until(lambda: robot.group["states"]["m0"]["refused"], timeout_s=20)
    node = await ParameterNode({"watts": 10}).serve(edges[0].node, "/gpu")
    await until(lambda: node.values["watts"] == 300, timeout_s=20)
    await until(lambda: not robot.group["states"]["m0"]["refused"])


async def test_the_robots_gateway_is_restarted(world: World) -> None:
    """A robot's gateway that is started anew finds its machines, and each frame is answered once, before and after."""
    edges = await edges_of(world, "edge1", "edge2")
    async with AsyncExitStack() as first_life:
        before = World(first_life)
        robot = Robot(before)
        await robot.start(edges, initial_policy=policy("standby", "service"))
        await robot.ask(0, 10)
    again = Robot(world)
    await again.start(edges, initial_policy=policy("service", "standby"))
    await again.ask(10, 10)
    assert sorted(number for edge in edges for number in edge.frames) == list(range(1, 21))
    assert [number for number, _ in again.found] == list(range(11, 21))
    current = again.group["current"]
    serving = next(edge for edge in edges if current.endswith(f":{edge.gateway.servers[0].listeners[0].port}"))
    await until(lambda: told(serving) == "service")
