"""Services and actions over two gateways, each with a network of its own, over real WebSockets."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable
from typing import Any

import pytest

from ropeway import aio
from ropeway.errors import CallError, CallFailed, GoalRejected
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import Graph
from ropeway.graph.calls import ActionHandlers, Client, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.types import TypeRegistry
from tests.support.until import PATIENCE_S, until
from tests.support.world import World, url

pytestmark = pytest.mark.jumping

ADD, FIBONACCI, TRIGGER = (
    "example_interfaces/srv/AddTwoInts",
    "example_interfaces/action/Fibonacci",
    "std_srvs/srv/Trigger",
)
ENCODINGS = ["none", "cbor", "cbor-raw", "zip", "rawzip", "zstd", "auto"]
HEAD = b"\0\1\0\0"
registry = TypeRegistry()


def service(name: str = "/add", type: str = ADD, **more: Any) -> dict[str, Any]:
    return {"name": name, "type": type, **more}


def action(name: str = "/fibonacci", **more: Any) -> dict[str, Any]:
    return {"name": name, "type": FIBONACCI, **more}


def pair(a: int, b: int) -> bytes:
    return struct.pack("<4sqq", HEAD, a, b)


def total(value: bytes) -> int:
    return int(struct.unpack("<4sq", value)[1])


def sequence(*values: int) -> bytes:
    return HEAD + struct.pack(f"<I{len(values)}i", len(values), *values)


async def add(request: Request) -> bytes:
    _, a, b = struct.unpack("<4sqq", request.payload)
    return struct.pack("<4sq", HEAD, a + b)


async def joined(world: World, operation: str, item: dict[str, Any], **settings: Any) -> tuple[Graph, Graph, Gateway]:
    """A robot that serves, a cloud that uses, and the gateway that dials in."""
    if operation.startswith("expose"):
        cloud = await world.gateway("cloud", [], **settings)
        dials = await world.gateway("robot", [{"address": url(cloud), operation: [item]}])
    else:
        robot = await world.gateway("robot", [], **settings)
        dials = await world.gateway("cloud", [{"address": url(robot), operation: [item]}])
    return await world.robot("robot"), await world.robot("cloud"), dials


async def there(graph: Graph, name: str, type: str) -> Client:
    client = await graph.create_client(name, type)
    assert await client.wait_available(PATIENCE_S)
    return client


@pytest.mark.parametrize("compression", ENCODINGS)
@pytest.mark.parametrize("operation", ["expose-service", "reserve-service"])
async def test_calls_cross(world: World, operation: str, compression: str) -> None:
    """Every encoding carries requests and responses both ways, many at a time."""
    server, caller, dials = await joined(world, operation, service(compression=compression))
    await server.create_service("/add", ADD, add)
    client = await there(caller, "/add", ADD)
    answers = await asyncio.gather(*(client.call(Request(pair(i, 2 * i))) for i in range(30)))
    assert [total(a) for a in answers] == [3 * i for i in range(30)]
    [route] = dials.status()["routes"]
    assert (route["state"], route["ended"]) == ("active", {"answered": 30})


@pytest.mark.parametrize("compression", ENCODINGS)
@pytest.mark.parametrize("operation", ["expose-action", "reserve-action"])
async def test_goals_cross(world: World, operation: str, compression: str) -> None:
    """Every encoding carries goals, feedback and results both ways."""

    async def execute(goal: ServerGoal) -> Outcome:
        (order,) = struct.unpack_from("<i", goal.payload, 4)
        for i in range(order):
            goal.feedback(sequence(*range(i + 1)))
        return Outcome(GoalStatus.SUCCEEDED, sequence(*range(order)))

    server, user, _ = await joined(world, operation, action(compression=compression))
    await server.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(execute))
    client = await user.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    feedback: list[bytes] = []
    goal = await client.send_goal(Goal(HEAD + struct.pack("<i", 3)), on_feedback=feedback.append)
    assert await goal.result(PATIENCE_S) == Outcome(GoalStatus.SUCCEEDED, sequence(0, 1, 2))
    await until(lambda: len(feedback) == 3)
    assert feedback == [sequence(0), sequence(0, 1), sequence(0, 1, 2)]


async def test_names_change(world: World) -> None:
    """A service may have another name on the far side, below a namespace."""
    cloud = await world.gateway("cloud", [])
    routes = {
        "address": url(cloud),
        "local_namespace": "/arm",
        "remote_namespace": "/robot7",
        "expose-service": [service("add", remote_name="sum")],
    }
    await world.gateway("robot", [routes])
    server, caller = await world.robot("robot"), await world.robot("cloud")
    await server.create_service("/arm/add", ADD, add)
    client = await there(caller, "/robot7/sum", ADD)
    assert total(await client.call(Request(pair(20, 22)))) == 42


async def test_failures_cross(world: World) -> None:
    """What a provider says against a request is what the caller reads."""

    async def refuse(request: Request) -> bytes:
        raise CallFailed("/add", "the adder is tired")

    server, caller, _ = await joined(world, "expose-service", service())
    await server.create_service("/add", ADD, refuse)
    client = await there(caller, "/add", ADD)
    with pytest.raises(CallFailed, match="the adder is tired"):
        await client.call(Request(pair(1, 2)))


async def test_big_calls(world: World) -> None:
    """Requests and responses of megabytes cross whole."""
    type = "rcl_interfaces/srv/SetParametersAtomically"
    codec = registry.codec(f"{type}_Response")
    answer = codec.encode({"result": {"successful": True, "reason": "x" * 3_000_000}})

    async def handler(request: Request) -> bytes:
        assert len(request.payload) > 2_000_000
        return answer

    server, caller, _ = await joined(world, "expose-service", service("/big", type))
    await server.create_service("/big", type, handler)
    client = await there(caller, "/big", type)
    name = {"name": "y" * 2_000_000, "value": {"type": 1, "bool_value": True}}
    request = registry.codec(f"{type}_Request").encode({"parameters": [name]})
    assert await client.call(Request(request), 20) == answer


async def test_thousand_calls_at_once(world: World) -> None:
    """A thousand calls at once are all answered, each with its own answer."""
    server, caller, _ = await joined(world, "reserve-service", service())
    await server.create_service("/add", ADD, add)
    client = await there(caller, "/add", ADD)
    answers = await asyncio.gather(*(client.call(Request(pair(i, i)), 30) for i in range(1000)))
    assert [total(a) for a in answers] == [2 * i for i in range(1000)]


async def test_rejected_goal(world: World) -> None:
    """A goal that is rejected on one side is rejected on the other, with that very error."""

    async def execute(goal: ServerGoal) -> Outcome:
        raise AssertionError

    async def accept(goal: ServerGoal) -> bool:
        return False

    server, user, _ = await joined(world, "expose-action", action())
    await server.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(execute, accept))
    client = await user.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    with pytest.raises(GoalRejected):
        await client.send_goal(Goal(HEAD + struct.pack("<i", 3)))


def holds(started: asyncio.Event, ended: asyncio.Event) -> Callable[[ServerGoal], Any]:
    """Carries a goal out until somebody wants its end."""

    async def execute(goal: ServerGoal) -> Outcome:
        started.set()
        try:
            await goal.cancelled.wait()
        finally:
            ended.set()
        return Outcome(GoalStatus.CANCELED, sequence(7))

    return execute


@pytest.mark.parametrize("operation", ["expose-action", "reserve-action"])
async def test_cancel_crosses(world: World, operation: str) -> None:
    """A cancelled goal is cancelled at its provider, and ends as canceled with its result."""
    started, ended = asyncio.Event(), asyncio.Event()
    server, user, _ = await joined(world, operation, action())
    await server.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(holds(started, ended)))
    client = await user.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    goal = await client.send_goal(Goal(HEAD + struct.pack("<i", 3)))
    await started.wait()
    assert await goal.cancel()
    assert await goal.result(PATIENCE_S) == Outcome(GoalStatus.CANCELED, sequence(7))


@pytest.mark.parametrize("operation", ["expose-action", "reserve-action"])
async def test_gateway_stops_in_mid_goal(world: World, operation: str) -> None:
    """When a gateway stops, the goal is aborted for its user at once and cancelled at its provider."""
    started, ended = asyncio.Event(), asyncio.Event()
    server, user, dials = await joined(world, operation, action())
    await server.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(holds(started, ended)))
    client = await user.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    goal = await client.send_goal(Goal(HEAD + struct.pack("<i", 3)))
    await started.wait()
    await dials.__aexit__(None, None, None)
    assert (await goal.result(PATIENCE_S)).status is GoalStatus.ABORTED
    async with aio.timeout(PATIENCE_S):
        await ended.wait()


@pytest.mark.parametrize("operation", ["expose-service", "reserve-service"])
async def test_gateway_stops_in_mid_call(world: World, operation: str) -> None:
    """When a gateway stops, a call under way fails at once."""
    started = asyncio.Event()

    async def never(request: Request) -> bytes:
        started.set()
        await asyncio.Event().wait()
        return b""

    server, caller, dials = await joined(world, operation, service())
    await server.create_service("/add", ADD, never)
    client = await there(caller, "/add", ADD)

    async def call() -> None:
        with pytest.raises(CallError):
            await client.call(Request(pair(1, 2)), 3600)

    async with aio.timeout(PATIENCE_S), aio.TaskGroup() as group:
        group.create_task(call())
        await started.wait()
        await dials.__aexit__(None, None, None)


async def test_first_gateway_holds_the_name(world: World) -> None:
    """Of two robots that expose one name, the second is told who has it, and takes over when the first leaves."""
    cloud = await world.gateway("cloud", [])
    remotes = [{"address": url(cloud), "expose-service": [service("/where", TRIGGER)]}]
    clients = {}
    for name in ("first", "second"):
        clients[name] = await world.gateway(name, remotes)
        robot = await world.robot(name)

        async def answer(request: Request, name: str = name) -> bytes:
            return registry.codec(f"{TRIGGER}_Response").encode({"success": True, "message": name})

        await robot.create_service("/where", TRIGGER, answer)
        if name == "first":
            user = await world.robot("cloud")
            client = await there(user, "/where", TRIGGER)
    await until(lambda: clients["second"].status()["routes"][0]["state"] == "taken")
    assert "first" in clients["second"].status()["routes"][0]["error"]

    async def who() -> str:
        decoded = registry.codec(f"{TRIGGER}_Response").decode(await client.call(Request(HEAD + b"\0")))
        return str(decoded["message"])

    assert await who() == "first"
    await clients["first"].__aexit__(None, None, None)
    await until(lambda: clients["second"].status()["routes"][0]["state"] == "active")
    assert await client.wait_available(PATIENCE_S)
    assert await who() == "second"


async def test_circles_do_not_spin(world: World) -> None:
    """Two gateways that reserve one service from each other do not send a call round and round."""
    left = await world.gateway("left", [])
    right = await world.gateway("right", [{"address": url(left), "reserve-service": [service()]}])
    await world.gateway("third", [{"address": url(right), "reserve-service": [service()]}])
    server, far = await world.robot("left"), await world.robot("third")
    await server.create_service("/add", ADD, add)
    client = await there(far, "/add", ADD)
    assert total(await client.call(Request(pair(3, 4)))) == 7
