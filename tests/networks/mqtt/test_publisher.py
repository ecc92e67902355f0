"""ropeway.networks.mqtt.publisher: topics that are published to a broker."""

from __future__ import annotations

from dataclasses import replace

from ropeway.graph.base import Delivery, Undelivered
from ropeway.networks.mqtt.maps import MqttMap, MqttMaps
from ropeway.qos import QoS
from tests.support.messages import STRING, sample, text
from tests.support.until import until

from .conftest import Place


async def test_what_cannot_be_sent(place: Place) -> None:
    """A message that its form cannot write, one above what the broker takes, and one after the end are counted."""
    graph, device = await place.graph(), place.device("t")
    publisher = await graph.create_publisher("/t", STRING)
    bad = sample("bad")
    bad.payload = b"\0\1\0\0\xff"
    publisher.publish(bad)
    graph.connection.limits = replace(graph.connection.limits, packet_bytes=1000)
    publisher.publish(sample("x" * 1000))
    publisher.publish(sample("good"))
    await until(lambda: device.got)
    assert device.got == [("t", b"good")]
    assert graph.drops == {("/t", Undelivered.ENCODE): 1}
    assert publisher.statistics().lost == {"it could not be encoded": 1}
    assert publisher.statistics().encoding == "text"
    await publisher.close()
    await publisher.close()
    publisher.publish(sample("late"))
    assert graph.drops["/t", Undelivered.CLOSED] == 1


async def test_sent_before_it_closes(place: Place) -> None:
    """What was published before a topic is closed still reaches the broker."""
    graph, device = await place.graph(), place.device("t")
    publisher = await graph.create_publisher("/t", STRING, QoS(depth=100))
    for number in range(60):
        publisher.publish(sample(f"{number}"))
    await publisher.close()
    await until(lambda: len(device.got) == 60)
    assert (publisher.waiting, publisher.subscribers) == (0, None)


async def test_lifespan(place: Place) -> None:
    """The lifespan of a route counts before that of the profile, and is the expiry of messages at the broker."""
    graph = await place.graph()
    for lifespan_s, expiry_s in ((None, 9), (1.5, 2)):
        publisher = await graph.create_publisher(
            "/t", STRING, QoS(lifespan_s=9.0), delivery=Delivery(lifespan_s=lifespan_s)
        )
        assert publisher._properties.of(sample("x")).MessageExpiryInterval == expiry_s


async def test_forms(place: Place) -> None:
    """The form of a map is that of the payload, and a latched map retains what is published."""
    graph = await place.graph(maps=MqttMaps([MqttMap("t", STRING, "cdr", latched=True)]))
    publisher = await graph.create_publisher("/t", STRING)
    publisher.publish(sample("kept"))
    await publisher.arrived()
    device = place.device("t")
    await until(lambda: device.got)
    assert (device.got[0][1], device.messages[0].retain) == (text("kept"), True)
