"""A bridge between two graphs within a program."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

import ropeway
from ropeway import AsyncGraph, Delivery, ExecutingGoal, GraphUnavailable, WaitTimeout
from tests.api.conftest import new_network
from tests.support.until import until

ADD = "example_interfaces/srv/AddTwoInts"
FIBONACCI = "example_interfaces/action/Fibonacci"


@pytest.fixture
async def graphs() -> AsyncIterator[tuple[AsyncGraph, AsyncGraph]]:
    """Two networks."""
    async with AsyncExitStack() as stack:
        left = await stack.enter_async_context(ropeway.open(new_network()))
        right = await stack.enter_async_context(ropeway.open(new_network()))
        yield left, right


async def test_topics(graphs: tuple[AsyncGraph, AsyncGraph]) -> None:
    """A topic crosses from left to right, another the other way under another name, and the status counts both."""
    left, right = graphs
    async with ropeway.open_bridge(left.url, right.url) as bridge:
        await bridge.topic("/up", "std_msgs/String", delivery=Delivery(rate_hz=1000))
        await bridge.topic("/down", "std_msgs/msg/String", reverse=True, rename="/robot/down", qos="latched")
        async with left.publisher("/up", "std_msgs/String") as up, right.subscribe("/up", timeout_s=10) as far:
            await up.wait_for_subscribers(timeout_s=10)
            up.publish({"data": "hi"})
            assert (await far.receive())["data"] == "hi"
        async with right.publisher("/down", "std_msgs/String", qos="latched") as down:
            down.publish({"data": "ho"})
            async with left.subscribe("/robot/down", timeout_s=10) as near:
                assert (await near.receive(timeout_s=10))["data"] == "ho"
        first, second = bridge.status()
        assert (first["name"], first["messages"], first["error"]) == ("/up", 1, "")
        assert (second["name"], second["rename"], second["source"]) == ("/down", "/robot/down", right.url)


async def test_both_ways(graphs: tuple[AsyncGraph, AsyncGraph]) -> None:
    """A topic that is joined both ways brings each message once, and no echo."""
    left, right = graphs
    async with ropeway.open_bridge(left.url, right.url) as bridge:
        await bridge.topic("/chat", "std_msgs/String")
        await bridge.topic("/chat", "std_msgs/String", reverse=True)
        async with (
            left.publisher("/chat", "std_msgs/String") as publisher,
            left.subscribe("/chat") as near,
            right.subscribe("/chat", "std_msgs/String") as far,
        ):
            await publisher.wait_for_subscribers(2, timeout_s=10)
            for number in range(5):
                publisher.publish({"data": str(number)})
                assert (await far.receive(timeout_s=10))["data"] == str(number)
                assert (await near.receive())["data"] == str(number)
            with pytest.raises(WaitTimeout):
                await near.receive(timeout_s=0.1)


async def test_two_bridges() -> None:
    """Two bridges that join the same networks both ways bring each message once, and it does not go in circles."""
    urls = "dds:58?interface=lo", "dds:59?interface=lo"
    async with (
        ropeway.open(urls[0], name="left") as left,
        ropeway.open(urls[1], name="right") as right,
        ropeway.open_bridge(*urls, name="one") as one,
        ropeway.open_bridge(*urls, name="two") as two,
        left.publisher("/chat", "std_msgs/String") as publisher,
        left.subscribe("/chat") as near,
        right.subscribe("/chat", "std_msgs/String") as far,
    ):
        for bridge in (one, two):
            await bridge.topic("/chat", "std_msgs/String")
            await bridge.topic("/chat", "std_msgs/String", reverse=True)
        await publisher.wait_for_subscribers(3, timeout_s=20)
        there = [bridge._right.hub.publishers for bridge in (one, two)]
        await until(lambda: sum(publishers["/chat"][0].standby.defers for publishers in there) == 1, 20)
        for number in range(5):
            publisher.publish({"data": str(number)})
        assert [(await far.receive(timeout_s=20))["data"] for _ in range(5)] == list("01234")
        assert [(await near.receive())["data"] for _ in range(5)] == list("01234")
        for subscription in (near, far):
            with pytest.raises(WaitTimeout):
                await subscription.receive(timeout_s=0.5)


async def test_calls(graphs: tuple[AsyncGraph, AsyncGraph]) -> None:
    """A service and an action of the left graph are offered on the right, with the types that they have."""
    left, right = graphs

    async def fibonacci(goal: ExecutingGoal) -> dict[str, list[int]]:
        return {"sequence": [goal.request["order"]]}

    async with (
        left.serve("/add", ADD, lambda request: {"sum": request["a"] + request["b"]}),
        left.serve_action("/fib", FIBONACCI, fibonacci),
        ropeway.open_bridge(left.url, right.url) as bridge,
    ):
        await bridge.service("/add", rename="/far/add", call_timeout_s=10)
        await bridge.action("/fib")
        assert (await right.call("/far/add", {"a": 1, "b": 2}, timeout_s=10))["sum"] == 3
        async with right.action_client("/fib", timeout_s=10) as client:
            ended = await (await client.send_goal({"order": 9})).result(timeout_s=10)
            assert ended.result is not None
            assert list(ended.result["sequence"]) == [9]
        assert [row["state"] for row in bridge.status()] == ["active", "active"]
        await until(lambda: bridge.status()[1]["calls"] == {"succeeded": 1})
        assert bridge.status()[0]["calls"] == {"answered": 1}


async def test_close(graphs: tuple[AsyncGraph, AsyncGraph]) -> None:
    """A bridge that is closed leaves both networks, and takes nothing more."""
    left, right = graphs
    bridge = await ropeway.open_bridge(left.url, right.url)
    await bridge.topic("/a", "std_msgs/String")
    await bridge.close()
    await bridge.close()
    assert (left.topics(), right.topics()) == ({}, {})
    with pytest.raises(GraphUnavailable, match="the bridge is closed"):
        await bridge.topic("/b", "std_msgs/String")


async def test_one_side_cannot_be_opened(graphs: tuple[AsyncGraph, AsyncGraph]) -> None:
    """If the second graph cannot be opened, the first is left."""
    left, _ = graphs
    with pytest.raises(GraphUnavailable):
        await ropeway.open_bridge(left.url, "dds:999")
    assert len(left.nodes()) == 1


async def test_unknown_type(graphs: tuple[AsyncGraph, AsyncGraph]) -> None:
    """Without a type, a publisher is waited for."""
    async with ropeway.open_bridge(graphs[0].url, graphs[1].url) as bridge:
        with pytest.raises(WaitTimeout, match="no publisher of /a"):
            await bridge.topic("/a", timeout_s=0.01)
        assert bridge.status() == []


async def test_no_definition(tmp_path: Path) -> None:
    """A bridge needs no definition of the messages that it passes on."""
    (tmp_path / "my_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "my_msgs" / "msg" / "Level.msg").write_text("float32 percent\n")
    urls = "dds:58?interface=lo", "dds:59?interface=lo"
    async with (
        ropeway.open(urls[0], types=[tmp_path]) as left,
        ropeway.open(urls[1], types=[tmp_path]) as right,
        left.publisher("/level", "my_msgs/Level") as publisher,
        right.subscribe("/level", "my_msgs/Level") as far,
        ropeway.open_bridge(*urls) as bridge,
    ):
        await bridge.topic("/level", timeout_s=20)
        await publisher.wait_for_subscribers(timeout_s=20)
        publisher.publish({"percent": 0.5})
        assert (await far.receive(timeout_s=20))["percent"] == 0.5


async def test_to_a_server() -> None:
    """A bridge also joins a network with a rosbridge server."""
    config = {"gateway": {"graphs": [far := new_network()], "listen": ["ws://127.0.0.1:0"]}}
    async with (
        ropeway.open_gateway(config) as gateway,
        ropeway.open(near := new_network()) as graph,
        ropeway.open_bridge(near, f"ws://127.0.0.1:{gateway.ports[0]}") as bridge,
        ropeway.open(far) as there,
    ):
        await bridge.topic("/up", "std_msgs/String")
        async with graph.publisher("/up", "std_msgs/String") as up, there.subscribe("/up", timeout_s=10) as reader:
            await up.wait_for_subscribers(timeout_s=10)
            up.publish({"data": "hi"})
            assert (await reader.receive(timeout_s=10))["data"] == "hi"
