"""Publishers and subscriptions of programs."""

from __future__ import annotations

import asyncio
import logging

import pytest

import ropeway
from ropeway import GraphUnavailable, InvalidName, QoS, Refused, TypeConflict, TypedMessage, UnknownType, WaitTimeout
from tests.api.conftest import new_network
from tests.support.until import PATIENCE_S, until


async def test_one_graph_hears_itself(url: str) -> None:
    """What a program publishes reaches the subscriptions that it made on the same graph."""
    async with (
        ropeway.open(url) as graph,
        graph.publisher("chatter", "std_msgs/String") as publisher,
        graph.subscribe("/chatter") as subscription,
    ):
        assert (publisher.topic, publisher.type) == ("/chatter", "std_msgs/msg/String")
        assert (subscription.topic, subscription.type) == ("/chatter", "std_msgs/msg/String")
        await publisher.wait_for_subscribers()
        publisher.publish({"data": "hi"})
        message = await subscription.receive()
        assert message["data"] == "hi"
        assert message.topic == "/chatter"
        assert message.received_ns > 0


async def test_two_graphs(url: str) -> None:
    """What one program publishes reaches another, with the type found out by discovery, also if it closes at once."""
    async with (
        ropeway.open(url, name="reader") as reader,
        ropeway.open(url, name="writer") as writer,
        writer.publisher("/image", "sensor_msgs/Image") as publisher,
        reader.subscribe("/image", timeout_s=20) as subscription,
    ):
        await publisher.wait_for_subscribers(timeout_s=20)
        publisher.publish({"height": 3, "data": bytes(500_000)})
        await publisher.close()
        assert (await subscription.receive(timeout_s=20))["height"] == 3


async def test_await_instead_of_a_block(network: str) -> None:
    """What is awaited instead of entered stays open until it is closed."""
    graph = await ropeway.open(network)
    publisher = await graph.publisher("/a", "std_msgs/String")
    subscription = await graph.subscribe("/a")
    publisher.publish({"data": "hi"})
    assert (await subscription.receive())["data"] == "hi"
    await graph.close()
    await graph.close()
    with pytest.raises(GraphUnavailable, match="the publisher of /a is closed"):
        publisher.publish({"data": "hi"})
    with pytest.raises(GraphUnavailable, match="the subscription of /a is closed"):
        await subscription.receive()
    with pytest.raises(GraphUnavailable, match="it is closed"):
        await graph.publisher("/b", "std_msgs/String")


async def test_loop_over_messages(network: str) -> None:
    """A loop over messages gives each, and ends when the subscription or its graph is closed."""
    async with ropeway.open(network) as graph, graph.publisher("/a", "std_msgs/String") as publisher:
        subscription = await graph.subscribe("/a")
        for text in ("a", "b", "c"):
            publisher.publish({"data": text})
        found = []
        async for message in subscription:
            found.append(message["data"])
            if len(found) == 3:
                await subscription.close()
        assert found == ["a", "b", "c"]
        other = await graph.subscribe("/a")
        waiting = asyncio.create_task(_count(other))
        await asyncio.sleep(0)
        await graph.close()
        assert await waiting == 0


async def _count(subscription: ropeway.AsyncSubscription) -> int:
    return len([message async for message in subscription])


@pytest.mark.parametrize("coroutine", [False, True])
async def test_callback(network: str, coroutine: bool, caplog: pytest.LogCaptureFixture) -> None:
    """A function or a coroutine function gets each message in order; where it fails, the next one is taken."""
    found: list[str] = []

    def take(message: TypedMessage) -> None:
        if message["data"] == "b":
            raise ValueError("no b")
        found.append(message["data"])

    async def take_later(message: TypedMessage) -> None:
        await asyncio.sleep(0)
        take(message)

    async with (
        ropeway.open(network) as graph,
        graph.publisher("/a", "std_msgs/String") as publisher,
        graph.subscribe("/a", callback=take_later if coroutine else take) as subscription,
    ):
        for text in ("a", "b", "c"):
            publisher.publish({"data": text})
        await until(lambda: found == ["a", "c"])
        assert subscription.failures == 1
        assert sum(graph.drops.values()) == 1
        with pytest.raises(RuntimeError, match="go to a callback"):
            await subscription.receive()
    assert [record.levelno for record in caplog.records] == [logging.ERROR]


async def test_callback_closes_its_subscription(network: str) -> None:
    """A callback may close its own subscription, and gets nothing more."""
    found: list[str] = []
    done = asyncio.Event()

    async def take(message: TypedMessage) -> None:
        found.append(message["data"])
        await subscription.close()
        done.set()

    async with ropeway.open(network) as graph, graph.publisher("/a", "std_msgs/String") as publisher:
        subscription = await graph.subscribe("/a", callback=take)
        publisher.publish({"data": "a"})
        publisher.publish({"data": "b"})
        await asyncio.wait_for(done.wait(), PATIENCE_S)
        publisher.publish({"data": "c"})
        assert publisher.subscribers == 0
    assert found == ["a"]


async def test_pass_on(network: str) -> None:
    """A message that was received is passed on as it is, once, and refused by a publisher of another type."""
    async with ropeway.open(network) as graph, ropeway.open(new_network()) as other:
        source = await graph.publisher("/a", "std_msgs/String")
        reader = await graph.subscribe("/a")
        target = await other.publisher("/b", "std_msgs/String")
        far = await other.subscribe("/b")
        source.publish({"data": "hi"})
        message = await reader.receive()
        target.publish(message)
        target.publish(message)
        target.publish({"data": "last"})
        passed = await far.receive()
        assert passed.raw == message.raw
        assert passed.topic == "/b"
        assert (await far.receive())["data"] == "last"
        wrong = await other.publisher("/c", "std_msgs/Bool")
        with pytest.raises(TypeConflict):
            wrong.publish(message)


async def test_full_queue(network: str) -> None:
    """Messages that a program does not take in time are dropped, the oldest first, and counted."""
    async with (
        ropeway.open(network) as graph,
        graph.publisher("/a", "std_msgs/String") as publisher,
        graph.subscribe("/a", queue_messages=2) as subscription,
    ):
        for text in "abcde":
            publisher.publish({"data": text})
        assert (await subscription.receive())["data"] == "d"
        assert subscription.dropped == 3


async def test_waits_end(network: str) -> None:
    """Waits for a message, a subscriber and a type end with what was waited for, as a TimeoutError too."""
    async with ropeway.open(network) as graph:
        async with graph.publisher("/a", "std_msgs/String") as publisher, graph.subscribe("/a") as subscription:
            with pytest.raises(WaitTimeout, match="no message on /a of memory:"):
                await subscription.receive(timeout_s=0.01)
            with pytest.raises(WaitTimeout, match="no 2 subscribers of /a on memory:"):
                await publisher.wait_for_subscribers(2, timeout_s=0.01)
        with pytest.raises(TimeoutError, match=r"no publisher of /b .* name its type to go on without it"):
            await graph.subscribe("/b", timeout_s=0.01)


async def test_close_ends_waits(network: str) -> None:
    """Whoever waits for subscribers or messages is told when the graph is closed."""
    graph = await ropeway.open(network)
    publisher = await graph.publisher("/a", "std_msgs/String")
    subscription = await graph.subscribe("/b", "std_msgs/String")
    waiting = [
        asyncio.ensure_future(publisher.wait_for_subscribers(timeout_s=None)),
        asyncio.ensure_future(subscription.receive(timeout_s=None)),
    ]
    await asyncio.sleep(0)
    await graph.close()
    for wait in waiting:
        with pytest.raises(GraphUnavailable):
            await wait


async def test_type_comes_later(network: str) -> None:
    """A subscription without a type waits for the first publisher."""
    async with ropeway.open(network) as graph, ropeway.open(network) as other:
        waiting = asyncio.ensure_future(graph.subscribe("/a"))
        await asyncio.sleep(0)
        async with other.publisher("/a", "std_msgs/Bool") as publisher, await waiting as subscription:
            publisher.publish({"data": True})
            assert (await subscription.receive())["data"] is True


async def test_qos(network: str) -> None:
    """A profile is given itself or by name, is adopted where none is given, and a wrong name tells the right ones."""
    async with ropeway.open(network) as graph:
        async with graph.publisher("/map", "std_msgs/String", qos="latched") as publisher:
            assert publisher.qos.transient_local
            publisher.publish({"data": "kept"})
            async with graph.subscribe("/map") as subscription:
                assert (await subscription.receive())["data"] == "kept"
                assert subscription.qos.transient_local
            async with graph.subscribe("/map", qos=QoS(reliability="best_effort")) as subscription:
                assert not subscription.qos.reliable
        with pytest.raises(ValueError, match="'fast' is not a QoS profile; use one of default"):
            graph.publisher("/map", "std_msgs/String", qos="fast")


async def test_mistakes(network: str) -> None:
    """Wrong names and types are refused with what is wrong, and leave nothing behind."""
    async with ropeway.open(network) as graph:
        with pytest.raises(InvalidName):
            await graph.publisher("/a b", "std_msgs/String")
        with pytest.raises(UnknownType, match="did you mean std_msgs/msg/String"):
            await graph.publisher("/a", "std_msgs/Strin")
        async with graph.publisher("/a", "std_msgs/String"):
            with pytest.raises(UnknownType):
                await graph.subscribe("/a", "std_msgs/Nothing")
        assert graph.topics() == {}


async def test_refusal(caplog: pytest.LogCaptureFixture) -> None:
    """A topic that a server does not give or take is an error for whoever publishes or waits, else it is logged."""
    auth = {"roles": {"viewer": {"subscribe": ["/open"]}}, "default_role": "viewer"}
    config = {"gateway": {"graphs": [new_network()], "listen": ["ws://127.0.0.1:0"], "auth": auth}}
    async with (
        ropeway.open_gateway(config) as gateway,
        ropeway.open(f"ws://127.0.0.1:{gateway.ports[0]}") as graph,
        graph.subscribe("/secret", "std_msgs/String") as subscription,
    ):
        with pytest.raises(Refused, match="/secret was refused"):
            await graph.publisher("/secret", "std_msgs/String")
        with pytest.raises(Refused, match="/secret was refused"):
            await subscription.receive(timeout_s=20)
        caplog.clear()
        async with graph.subscribe("/secret", "std_msgs/String", print):
            await until(lambda: "/secret was refused" in caplog.text)
