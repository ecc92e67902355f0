"""ropeway.networks.mqtt.reading: feeds and the subscriptions that share them."""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any

from ropeway.fault_log import FaultLog
from ropeway.graph.base import Sample, Undelivered
from ropeway.limits import MQTT_KEPT_TOPICS
from ropeway.networks.mqtt.connection import Wish
from ropeway.networks.mqtt.maps import MqttMap
from ropeway.networks.mqtt.reading import MqttFeed, MqttFeeds, MqttSubscription
from ropeway.networks.mqtt.wire import Received
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.messages import STRING


class Reader:
    """A graph as subscriptions see it."""

    def __init__(self) -> None:
        self.name, self.drops, self.registry = "mqtt", Counter[tuple[str, Undelivered]](), TypeRegistry()
        self.fault_log, self.loop = FaultLog("mqtt"), asyncio.get_running_loop()
        self.publishers: list[QoS] = []
        self.wishes: list[Wish] = []
        self.came_from: list[str] = []

    def guard(self, topic: str, callback: Any, value: Any) -> None:
        callback(value)

    def offered(self, topic: str) -> list[QoS]:
        return self.publishers

    def came(self, topic: str, sample: Sample) -> None:
        self.came_from.append(topic)

    def asked(self, feed: MqttFeed) -> None:
        self.wishes.append(feed.wish)

    async def forget(self, subscription: MqttSubscription) -> None:
        pass

    def subscribe(self, feed: MqttFeed, qos: QoS | None, map: MqttMap | None = None) -> tuple[MqttSubscription, Inbox]:
        inbox = Inbox()
        made = MqttSubscription(self, "/t", STRING, qos, inbox, map)
        made.join(feed)
        return made, inbox


def received(payload: bytes, *, topic: str = "t", retained: bool = False, seq: int = 0, type: str = "") -> Received:
    return Received(topic, payload, retained, bytes(16), seq, type, told=bool(seq))


async def test_wishes() -> None:
    """A feed asks for as much as the most demanding of its subscriptions wants."""
    graph, feed = Reader(), MqttFeed("t")
    graph.subscribe(feed, SENSOR_DATA)
    assert feed.wish == Wish(0, False)
    graph.subscribe(feed, QoS())
    assert feed.wish == Wish(1, False)
    graph.subscribe(feed, None)
    assert feed.wish == Wish(1, True)


async def test_retained() -> None:
    """The last value goes to latched subscriptions once, however often the broker repeats it; late joiners get it."""
    graph, feed = Reader(), MqttFeed("t")
    (_, latched), (_, volatile) = graph.subscribe(feed, LATCHED), graph.subscribe(feed, QoS())
    for payload in (b"a", b"a", b"b", b"b"):
        feed.take(received(payload, retained=True))
    feed.take(received(b"b"))
    _, late = graph.subscribe(feed, LATCHED)
    await latched.wait(3)
    await volatile.wait(1)
    await late.wait(1)
    assert (latched.texts, volatile.texts, late.texts) == (["a", "b", "b"], ["b"], ["b"])


async def test_adopts() -> None:
    """A subscription without a profile follows the publishers, and gets the last value when they latch."""
    graph, feed = Reader(), MqttFeed("t")
    subscription, inbox = graph.subscribe(feed, None)
    feed.take(received(b"kept", retained=True))
    graph.publishers = [LATCHED]
    subscription.readopt()
    await inbox.wait(1)
    graph.publishers = [SENSOR_DATA]
    subscription.readopt()
    assert (subscription.qos.reliable, graph.wishes) == (False, [Wish(0, True)])
    await subscription.close()
    await subscription.close()
    subscription.readopt()
    feed.take(received(b"late"))
    assert inbox.texts == ["kept"]


async def test_told_once() -> None:
    """A message that tells its identity comes once to who keeps the last value, and one of another type never."""
    graph, feed = Reader(), MqttFeed("t")
    _, inbox = graph.subscribe(feed, LATCHED)
    feed.take(received(b"a", seq=1))
    feed.take(received(b"a", seq=1))
    feed.take(received(b"a", seq=2))
    feed.take(received(b"x", seq=3, type="std_msgs/msg/Int8"))
    await inbox.wait(2)
    assert (inbox.texts, graph.drops) == (["a", "a"], {("/t", Undelivered.DECODE): 1})
    assert graph.came_from == ["t", "t"]


async def test_commands_that_end() -> None:
    """A form that ends a command by itself publishes the end later, unless another command comes first."""
    graph, feed, inbox = Reader(), MqttFeed("t"), Inbox()
    twist = MqttMap("t", "geometry_msgs/msg/Twist", "angle", options={"rate_rad_s": 1000.0})
    subscription = MqttSubscription(graph, "/t", twist.type, QoS(), inbox, twist)
    subscription.join(feed)
    feed.take(received(b"90000"))
    feed.take(received(b"1"))
    await inbox.wait(3)
    assert len({one.seq for one in inbox.samples[1:]}) == 2
    feed.take(received(b"90000"))
    await subscription.close()
    assert len(inbox.samples) == 3


def test_feeds_of_topics() -> None:
    """A topic goes to the feed of its own and to those whose filters match."""
    feeds = MqttFeeds()
    own, level, all = feeds.add("a/b"), feeds.add("a/+"), feeds.add("#")
    assert feeds.of("a/b") == (own, level, all)
    assert feeds.of("c") == (all,)
    feeds.remove(all)
    assert feeds.of("c") == ()
    assert [*feeds] == [own, level]
    for number in range(5000):
        feeds.of(f"a/{number}")
    assert len(feeds._matched) <= 4096


async def test_kept_values_are_bounded() -> None:
    """Of the topics of a filter as many keep their last value as are allowed."""
    graph, feed = Reader(), MqttFeed("#")
    graph.subscribe(feed, LATCHED)
    for number in range(MQTT_KEPT_TOPICS + 50):
        feed.take(received(b"x", topic=f"{number}"))
    _, late = graph.subscribe(feed, LATCHED)
    await late.wait(MQTT_KEPT_TOPICS)
    assert len(late.samples) == MQTT_KEPT_TOPICS
