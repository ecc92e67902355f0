"""Publishers and subscriptions of threads."""

from __future__ import annotations

import threading

import pytest

from ropeway import GraphUnavailable, TypedMessage, ValueMismatch, WaitTimeout, blocking


@pytest.mark.parametrize("url", ["memory:blocking-topics", "dds:58?interface=lo"])
def test_topic(url: str) -> None:
    """What one graph publishes is received by another, and in a loop, which the end of the subscription ends."""
    with (
        blocking.open(url, name="one") as one,
        blocking.open(url, name="two") as two,
        one.publisher("chatter", "std_msgs/String") as publisher,
        two.subscribe("/chatter", timeout_s=20) as subscription,
    ):
        assert publisher.topic == subscription.topic == "/chatter"
        assert publisher.type == subscription.type == "std_msgs/msg/String"
        assert publisher.qos.reliable
        assert subscription.qos.reliable
        publisher.wait_for_subscribers(timeout_s=20)
        assert publisher.subscribers == 1
        for text in "abc":
            publisher.publish({"data": text})
        assert subscription.receive(timeout_s=20)["data"] == "a"
        found = []
        for message in subscription:
            found.append(message["data"])
            if len(found) == 2:
                subscription.close()
        assert found == ["b", "c"]
        assert subscription.dropped == 0


def test_callback_may_wait(network: str) -> None:
    """A callback runs in a thread of its own, one message at a time, and may use the graph."""
    found: list[tuple[str, str]] = []
    done = threading.Event()

    def take(message: TypedMessage) -> None:
        if message["data"] == "b":
            raise ValueError("no b")
        found.append((message["data"], threading.current_thread().name))
        answers.publish({"data": message["data"].upper()})
        if message["data"] == "c":
            done.set()

    with (
        blocking.open(network) as graph,
        graph.publisher("/a", "std_msgs/String") as publisher,
        graph.publisher("/b", "std_msgs/String") as answers,
        graph.subscribe("/b") as back,
        graph.subscribe("/a", callback=take) as subscription,
    ):
        for text in "abc":
            publisher.publish({"data": text})
        assert done.wait(10)
        assert [text for text, _ in found] == ["a", "c"]
        assert all(name.startswith("ropeway.callback") for _, name in found)
        assert [back.receive()["data"], back.receive()["data"]] == ["A", "C"]
        assert subscription.failures == 1


def test_callback_closes_its_graph(network: str) -> None:
    """A callback may close its own subscription and its graph."""
    done = threading.Event()

    def take(message: TypedMessage) -> None:
        subscription.close()
        graph.close()
        done.set()

    graph = blocking.open(network)
    publisher = graph.publisher("/a", "std_msgs/String")
    subscription = graph.subscribe("/a", callback=take)
    publisher.publish({"data": "a"})
    assert done.wait(10)


def test_many_threads(network: str) -> None:
    """Threads publish on one publisher at the same time, and nothing is lost."""
    with (
        blocking.open(network) as graph,
        graph.publisher("/a", "std_msgs/Int32") as publisher,
        graph.subscribe("/a") as subscription,
    ):

        def publish(first: int) -> None:
            for number in range(first, first + 50):
                publisher.publish({"data": number})

        threads = [threading.Thread(target=publish, args=(50 * n,)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(subscription.receive()["data"] for _ in range(200)) == list(range(200))


def test_errors(network: str) -> None:
    """Errors are those of asyncio: values that do not fit, time that is over, and what is closed."""
    with blocking.open(network) as graph:
        publisher = graph.publisher("/a", "std_msgs/String")
        with pytest.raises(ValueMismatch):
            publisher.publish({"data": 5})
        with graph.subscribe("/a") as subscription, pytest.raises(WaitTimeout):
            subscription.receive(timeout_s=0.01)
        with pytest.raises(WaitTimeout):
            publisher.wait_for_subscribers(timeout_s=0.01)
        publisher.close()
        publisher.close()
        with pytest.raises(GraphUnavailable):
            publisher.publish({"data": "a"})
    with pytest.raises(GraphUnavailable):
        publisher.publish({"data": "a"})
    graph.close()
