"""Services and actions among genuine nodes of rmw_fastrtps; skipped where rclpy is not there."""

from __future__ import annotations

import asyncio
import os
import signal
import struct
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway import aio
from ropeway.errors import ProviderLost
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.hub.hub import Hub
from ropeway.networks.dds import DdsGraph
from ropeway.networks.rosbridge.server import RosbridgeServer
from ropeway.types import TypeRegistry
from tests.support.ros2 import FAST, Peer, need_rclpy, need_rmw, start_peer
from tests.support.until import PATIENCE_S, until
from tests.support.websocket import Client

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]
need_rclpy()
need_rmw(FAST)

ADD = "example_interfaces/srv/AddTwoInts"
CAMERA = "sensor_msgs/srv/SetCameraInfo"
FIBONACCI = "example_interfaces/action/Fibonacci"
PROGRAM = Path(__file__).with_name("peer.py")
DOMAIN = 100 + os.getpid() % 20
REGISTRY = TypeRegistry()
NUMBERS = [0, 1, 1, 2, 3, 5, 8]


class World:
    """Genuine nodes, and our graphs beside them."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack

    async def node(self, *words: str, rmw: str = FAST) -> Peer:
        env = {"RMW_IMPLEMENTATION": rmw, "ROS_DOMAIN_ID": str(DOMAIN)}
        node = await start_peer(self.stack, PROGRAM, *words, env=env)
        await until(lambda: node.said)
        assert node.said[0]["ready"] == rmw
        return node

    async def graph(self, name: str = "ours") -> DdsGraph:
        graph = DdsGraph(DOMAIN, name=name, gateway_id=name, registry=REGISTRY)  # on this machine, as the nodes are
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph


@pytest.fixture
async def world(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[World]:
    """Nodes that stay on this machine; all are ended."""
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    async with AsyncExitStack() as stack:
        yield World(stack)


def addends(a: int, b: int = 7) -> bytes:
    return b"\0\1\0\0" + struct.pack("<qq", a, b)


async def add(request: Request) -> bytes:
    return b"\0\1\0\0" + struct.pack("<q", sum(struct.unpack_from("<qq", request.payload, 4)))


def total(payload: bytes) -> int:
    return int(struct.unpack_from("<q", payload, 4)[0])


async def test_served(world: World) -> None:
    """The first Fast DDS node of a network waits for a service of ours and gets all its answers, as later ones do."""
    graph = await world.graph()
    await graph.create_service("/add", ADD, add)
    for _ in range(3):
        node = await world.node("call", "/add", "--count", "50", "--seconds", "15")
        assert (await node.done()).items() >= {"answered": 50, "wrong": 0}.items()
    assert not graph.drops


async def test_served_late(world: World) -> None:
    """A Fast DDS node that was there before us is served from its first call on."""
    node = await world.node("call", "/add", "--count", "50", "--seconds", "20")
    graph = await world.graph()
    await graph.create_service("/add", ADD, add)
    assert (await node.done()).items() >= {"answered": 50, "wrong": 0}.items()


async def test_called_as_soon_as_it_is_seen(world: World) -> None:
    """Clients of a server of ours whose calls have little time never hear that a node they see does not serve."""
    graph = await world.graph()
    hub = Hub(graph)
    await hub.open()
    world.stack.push_async_callback(hub.close)
    server = RosbridgeServer(hub, REGISTRY)
    world.stack.push_async_callback(server.close)
    port = (await server.listen("ws://127.0.0.1:0")).port
    client = await world.stack.enter_async_context(Client(port))
    starting = asyncio.create_task(world.node("serve", "/add"))
    answers: list[Any] = []
    async with aio.timeout(PATIENCE_S):
        while not answers or not answers[-1]["result"]:
            listed = bool((seen := graph.services().get("/add")) and seen.servers)
            operation = {"op": "call_service", "service": "/add", "type": ADD, "args": {"a": 1, "b": 2}, "timeout": 0.1}
            client.send({**operation, "id": str(len(answers))})
            answers.append(await client.json())
            if listed and not answers[-1]["result"]:
                assert answers[-1]["values"] == "Timeout exceeded while waiting for service response"
    await starting
    assert answers[-1]["values"] == {"sum": 3}


async def test_called(world: World) -> None:
    """Two clients of ours call one Fast DDS node at once; none gets the other's answers, and no call is lost."""
    await world.node("serve", "/add")
    clients = [await (await world.graph(name)).create_client("/add", ADD) for name in ("one", "two")]

    async def call(client: Any, first: int) -> None:
        assert await client.wait_available(PATIENCE_S)
        for a in range(first, first + 200):
            assert total(await client.call(Request(addends(a)), 8)) == a + 7

    await asyncio.gather(call(clients[0], 0), call(clients[1], 10**9))
    answers = await asyncio.gather(*(clients[0].call(Request(addends(a)), 20) for a in range(500)))
    assert [total(answer) for answer in answers] == list(range(7, 507))


async def test_big(world: World) -> None:
    """A megabyte goes through a service, both ways and in both roles."""
    graph = await world.graph()
    request, response = REGISTRY.codec(f"{CAMERA}_Request"), REGISTRY.codec(f"{CAMERA}_Response")

    async def turn(asked: Request) -> bytes:
        text = request.decode(asked.payload)["camera_info"]["distortion_model"]
        return response.encode({"success": True, "status_message": text[::-1]})

    await graph.create_service("/ours", CAMERA, turn)
    node = await world.node("call", "/ours", "--big", "1000000", "--count", "3", "--seconds", "20")
    assert (await node.done()).items() >= {"answered": 3, "wrong": 0}.items()
    await world.node("serve", "/theirs", "--big", "1")
    client = await graph.create_client("/theirs", CAMERA)
    assert await client.wait_available(PATIENCE_S)
    text = "".join(f"{n:08}" for n in range(125_000))
    asked = request.default()
    asked["camera_info"]["distortion_model"] = text
    answer = response.decode(await client.call(Request(request.encode(asked)), 10))
    assert answer["status_message"] == text[::-1]


async def test_both_kinds(world: World) -> None:
    """Nodes of Fast DDS and of Cyclone DDS call one service of ours at once, and each call is carried out once."""
    graph = await world.graph()
    asked: list[bytes] = []

    async def note(request: Request) -> bytes:
        asked.append(request.payload)
        return await add(request)

    await graph.create_service("/add", ADD, note)
    kinds = ["rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"] * 2
    nodes = [
        await world.node("call", "/add", "--count", "200", "--base", str(n * 1000), "--seconds", "20", rmw=kind)
        for n, kind in enumerate(kinds)
    ]
    for node in nodes:
        assert (await node.done()).items() >= {"answered": 200, "wrong": 0}.items()
    assert sorted(asked) == sorted(addends(n * 1000 + a) for n in range(4) for a in range(200))


async def test_action_used(world: World) -> None:
    """An action of a Fast DDS node gives feedback and a result, and can be cancelled."""
    await world.node("act", "/fibonacci", "--delay", "0.1")
    graph = await world.graph()
    client = await graph.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    goal_codec, result_codec = REGISTRY.codec(f"{FIBONACCI}_Goal"), REGISTRY.codec(f"{FIBONACCI}_Result")
    feedback: list[bytes] = []
    goal = await client.send_goal(Goal(goal_codec.encode({"order": 6})), on_feedback=feedback.append, timeout_s=10)
    outcome = await goal.result(PATIENCE_S)
    assert outcome.status == GoalStatus.SUCCEEDED
    assert outcome.payload is not None
    assert list(result_codec.decode(outcome.payload)["sequence"]) == NUMBERS
    assert feedback
    goal = await client.send_goal(Goal(goal_codec.encode({"order": 600})), timeout_s=10)
    await goal.cancel()
    assert (await goal.result(PATIENCE_S)).status == GoalStatus.CANCELED


async def test_action_served(world: World) -> None:
    """An action of ours is used by a Fast DDS node."""
    graph = await world.graph()
    codecs = [REGISTRY.codec(f"{FIBONACCI}_{part}") for part in ("Goal", "Feedback", "Result")]

    async def execute(goal: ServerGoal) -> Outcome:
        numbers = [0, 1]
        while len(numbers) <= codecs[0].decode(goal.payload)["order"]:
            numbers.append(numbers[-1] + numbers[-2])
            goal.feedback(codecs[1].encode({"sequence": numbers}))
            await asyncio.sleep(0.05)
        return Outcome(GoalStatus.SUCCEEDED, codecs[2].encode({"sequence": numbers}))

    await graph.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(execute))
    node = await world.node("goal", "/fibonacci", "--count", "6", "--seconds", "20")
    said = await node.done()
    assert said.items() >= {"accepted": True, "status": 4, "sequence": NUMBERS}.items()
    assert said["feedback"] >= 1


async def test_helper_killed(world: World) -> None:
    """A process that is killed in mid-call fails the call at once, and both roles work again within seconds."""
    await world.node("serve", "/theirs", "--delay", "1.5")
    graph = await world.graph()
    await graph.create_service("/ours", ADD, add)
    client = await graph.create_client("/theirs", ADD)
    assert await client.wait_available(PATIENCE_S)
    assert total(await client.call(Request(addends(1)), 10)) == 8
    assert graph._fast is not None
    helper = graph._fast._rpc.helper
    call = asyncio.create_task(client.call(Request(addends(2)), 10))
    await asyncio.sleep(0.5)
    os.kill(helper.pid, signal.SIGKILL)
    async with aio.timeout(1):
        with pytest.raises(ProviderLost):
            await call
    assert total(await client.call(Request(addends(3)), 8)) == 10
    node = await world.node("call", "/ours", "--count", "20", "--seconds", "20")
    assert (await node.done()).items() >= {"answered": 20, "wrong": 0}.items()
