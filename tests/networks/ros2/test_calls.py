"""Services and actions of the ``dds`` graph among genuine ROS 2 nodes; skipped where rclpy is not there."""

from __future__ import annotations

import asyncio
import os
import struct
import time
from asyncio.subprocess import DEVNULL, PIPE
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from ropeway import aio
from ropeway.errors import CallError, CallFailed, CallTimeout, GoalRejected, ProviderLost
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.dds import DdsGraph
from ropeway.types import TypeRegistry
from tests.networks.dds.calls import TRIGGER, Adder, add, called
from tests.support.ros2 import CYCLONE, FAST, Peer, need_rclpy, need_rmw, start_peer
from tests.support.services import ADD
from tests.support.until import PATIENCE_S, until

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]
need_rclpy()
need_rmw(CYCLONE)

FIBONACCI = "example_interfaces/action/Fibonacci"
PROGRAM = Path(__file__).with_name("ros2_calls_peer.py")
DOMAIN = 140 + os.getpid() % 10


class World:
    """Genuine nodes, and our graph beside them."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.registry = TypeRegistry()

    async def node(self, *words: object, rmw: str = CYCLONE) -> Peer:
        env = {"RMW_IMPLEMENTATION": rmw, "ROS_DOMAIN_ID": str(DOMAIN)}
        peer = await start_peer(self.stack, PROGRAM, *words, env=env)
        await peer.wait(lambda: "ready" in peer.told)
        assert peer.told["ready"] == rmw
        return peer

    async def graph(self, name: str = "ours", *, fast: bool = True) -> DdsGraph:
        graph = DdsGraph(DOMAIN, name=name, interface="lo", registry=self.registry, fast=fast)
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph

    async def ros2(self, *words: str) -> str:
        """What ``ros2`` prints."""
        env = {**os.environ, "RMW_IMPLEMENTATION": CYCLONE, "ROS_DOMAIN_ID": str(DOMAIN)}
        process = await asyncio.create_subprocess_exec("ros2", *words, stdout=PIPE, stderr=DEVNULL, env=env)
        async with aio.timeout(60):
            try:
                out, _ = await process.communicate()
            finally:
                if process.returncode is None:
                    process.kill()
        return out.decode()


@pytest.fixture
async def world(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[World]:
    """Nodes that stay on this machine; all are ended."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)  # genuine nodes have no tag
    async with AsyncExitStack() as stack:
        yield World(stack)


# Services -----------------------------------------------------------------------------------------------------------


async def test_calls_a_node(world: World) -> None:
    """A node answers our calls, the first one too, one after the other and a thousand at a time."""
    graph = await world.graph()
    peer = await world.node("serve", "/add")
    client = await called(graph, "/add")
    assert await add(client, 1, 2) == 3
    times = []
    for number in range(100):
        began = time.perf_counter()
        assert await add(client, number, 1) == number + 1
        times.append(time.perf_counter() - began)
    print(f"a node answers in {sorted(times)[50] * 1e6:.0f} us (p50)")
    sums = await asyncio.gather(*(add(client, 1000 + number, timeout_s=30) for number in range(1000)))
    assert sums == list(range(1000, 2000))
    await peer.wait(lambda: peer.told["served"] == 1100)
    (server,) = graph.services()["/add"].servers
    assert (server.node, server.gateway, server.local) == ("/peer", "", False)


async def test_first_call_of_a_new_client(world: World) -> None:
    """The very first call of a client that was made a moment ago is answered, time after time."""
    graph = await world.graph()
    await world.node("serve", "/add")
    await until(lambda: "/add" in graph.services())
    for number in range(10):
        client = await graph.create_client("/add", ADD)
        assert await add(client, number) == number
        await client.close()


async def test_slow_node(world: World) -> None:
    """A node that takes its time loses no request of many, and runs none twice."""
    graph = await world.graph()
    peer = await world.node("serve", "/add", "--delay", 0.02)
    client = await called(graph, "/add")
    assert await asyncio.gather(*(add(client, i, timeout_s=60) for i in range(100))) == list(range(100))
    await peer.wait(lambda: peer.told["served"] == 100)
    assert peer.told["different"] == 100


async def test_node_leaves(world: World) -> None:
    """A node that is gone fails a call, at the latest when its time is over."""
    graph = await world.graph()
    peer = await world.node("serve", "/add", "--delay", 30)
    client = await called(graph, "/add")
    call = asyncio.create_task(add(client, 1, timeout_s=5))
    await asyncio.sleep(0.5)
    await peer.end()
    with pytest.raises((ProviderLost, CallTimeout)):
        await call


async def test_serves_nodes(world: World) -> None:
    """Nodes get their answers from us, one after the other and many at a time."""
    graph = await world.graph()
    adder = Adder()
    await graph.create_service("/add", ADD, adder)
    one = await world.node("call", "/add", "--count", 200)
    await one.wait(lambda: "right" in one.told)
    assert one.told["right"] == 200
    print(f"a node gets its answer in {one.told['p50_us']:.0f} us (p50)")
    burst = await world.node("call", "/add", "--count", 300, "--burst")
    await burst.wait(lambda: "right" in burst.told)
    assert burst.told["right"] == 300
    assert len(adder.requests) == 500
    assert {request.caller for request in adder.requests} == {"/peer"}


async def test_ros2_service(world: World) -> None:
    """``ros2 service`` and ``ros2 node`` list, type and call our services; what failed says why."""
    graph = await world.graph()
    await graph.create_service("/add", ADD, Adder())

    async def fail(request: Request) -> bytes:
        raise CallFailed("/trigger", "the arm is not homed")

    await graph.create_service("/trigger", TRIGGER, fail)
    await world.ros2("daemon", "stop")
    listed = await world.ros2("service", "list", "-t", "--no-daemon", "--spin-time", "2")
    assert f"/add [{ADD}]" in listed
    assert f"/trigger [{TRIGGER}]" in listed
    info = await world.ros2("node", "info", "/ours", "--no-daemon", "--spin-time", "2")
    assert f"/add: {ADD}" in info.partition("Service Servers:")[2].partition("Service Clients:")[0]
    assert "sum=42" in await world.ros2("service", "call", "/add", ADD, "{a: 40, b: 2}")
    assert "message='the arm is not homed'" in await world.ros2("service", "call", "/trigger", TRIGGER)


async def test_fast_dds(world: World) -> None:
    """Without help, nodes of Fast DDS are neither called nor answered in a mapping that they do not speak."""
    need_rmw(FAST)
    graph = await world.graph(fast=False)
    peer = await world.node("serve", "/theirs", rmw=FAST)
    client = await graph.create_client("/theirs", ADD)
    await until(lambda: "/theirs" in graph.services() and client._others)
    with pytest.raises(CallFailed, match="over Fast DDS only"):
        await add(client, 1)
    adder = Adder()
    service = await graph.create_service("/ours", ADD, adder)
    await world.node("call", "/ours", "--patience", 2, rmw=FAST)
    await until(lambda: service.ignored)
    assert not adder.requests
    assert "served" not in peer.told


# Actions ------------------------------------------------------------------------------------------------------------


def order(number: int) -> bytes:
    """A Fibonacci_Goal as CDR."""
    return b"\0\1\0\0" + struct.pack("<i", number)


def numbers(payload: bytes | None) -> list[int]:
    """The sequence of a Fibonacci_Result or _Feedback."""
    assert payload is not None
    (count,) = struct.unpack_from("<I", payload, 4)
    return list(struct.unpack_from(f"<{count}i", payload, 8))


async def count(goal: ServerGoal) -> Outcome:
    """Count Fibonacci numbers."""
    (until_order,) = struct.unpack_from("<i", goal.payload, 4)
    sequence = [0, 1]

    def message() -> bytes:
        return b"\0\1\0\0" + struct.pack(f"<I{len(sequence)}i", len(sequence), *sequence)

    while len(sequence) < until_order:
        sequence.append(sequence[-1] + sequence[-2])
        goal.feedback(message())
        try:
            await asyncio.wait_for(goal.cancelled.wait(), 0.05)
        except TimeoutError:
            continue
        return Outcome(GoalStatus.CANCELED, message())
    return Outcome(GoalStatus.SUCCEEDED, message())


async def test_uses_an_action(world: World) -> None:
    """A node takes our goals, with feedback and result; a goal that it refuses or aborts is told as such."""
    graph = await world.graph()
    await world.node("act", "/fibonacci", "--delay", 0.05)
    client = await graph.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    heard: list[int] = []
    goal = await client.send_goal(Goal(order(6)), on_feedback=lambda payload: heard.append(len(numbers(payload))))
    outcome = await goal.result(PATIENCE_S)
    assert (outcome.status, numbers(outcome.payload)) == (GoalStatus.SUCCEEDED, [0, 1, 1, 2, 3, 5])
    assert heard == [3, 4, 5, 6]
    with pytest.raises(GoalRejected):
        await client.send_goal(Goal(order(-1)))
    goal = await client.send_goal(Goal(order(41)))
    assert (await goal.result(PATIENCE_S)).status is GoalStatus.ABORTED
    info = graph.actions()["/fibonacci"]
    assert (info.type, [server.node for server in info.servers]) == (FIBONACCI, ["/peer"])


async def test_cancels_an_action(world: World) -> None:
    """A goal at a node ends when we ask for it."""
    graph = await world.graph()
    await world.node("act", "/fibonacci", "--delay", 0.1)
    client = await graph.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    goal = await client.send_goal(Goal(order(40)))
    await asyncio.sleep(0.3)
    assert await goal.cancel()
    outcome = await goal.result(PATIENCE_S)
    assert outcome.status is GoalStatus.CANCELED
    assert 2 < len(numbers(outcome.payload)) < 40


async def test_serves_an_action(world: World) -> None:
    """Nodes send us goals, hear feedback, get results and cancel."""
    graph = await world.graph()
    await graph.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(count))
    peer = await world.node("goal", "/fibonacci", "--order", 6)
    await peer.wait(lambda: "status" in peer.told)
    assert (peer.told["status"], peer.told["sequence"], peer.told["heard"]) == (4, [0, 1, 1, 2, 3, 5], [3, 4, 5, 6])
    peer = await world.node("goal", "/fibonacci", "--order", 40, "--cancel")
    await peer.wait(lambda: "status" in peer.told)
    assert (peer.told["cancelling"], peer.told["status"]) == (1, 5)


async def test_many_goals(world: World) -> None:
    """Fifty goals at a time at a node all end with their result."""
    graph = await world.graph()
    await world.node("act", "/fibonacci")
    client = await graph.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)

    async def one(number: int) -> list[int]:
        goal = await client.send_goal(Goal(order(number)), timeout_s=30)
        return numbers((await goal.result(PATIENCE_S)).payload)

    try:
        sequences = await asyncio.gather(*(one(3 + i % 20) for i in range(50)))
    except CallError as error:  # pragma: no cover - tells which
        pytest.fail(str(error))
    assert [len(sequence) for sequence in sequences] == [3 + i % 20 for i in range(50)]


async def test_ros2_action(world: World) -> None:
    """``ros2 action`` lists our actions, tells who serves them, and sends goals."""
    graph = await world.graph()
    await graph.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(count))
    await world.ros2("daemon", "stop")
    assert f"/fibonacci [{FIBONACCI}]" in await world.ros2("action", "list", "-t")
    assert "Action servers: 1\n    /ours" in await world.ros2("action", "info", "/fibonacci")
    sent = await world.ros2("action", "send_goal", "-f", "/fibonacci", FIBONACCI, "{order: 4}")
    assert sent.count("Feedback:") == 2
    assert "status: SUCCEEDED" in sent
