"""ropeway.networks.mqtt.graph: topics of a real broker, and devices that know nothing of ROS."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import pytest

from ropeway.errors import GraphUnavailable, InvalidName, TypeConflict
from ropeway.graph.base import Sample, Undelivered
from ropeway.limits import MQTT_TOPICS
from ropeway.networks.mqtt.discovery import UNLISTED
from ropeway.networks.mqtt.maps import BYTES, MqttMap, MqttMaps
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.until import until

from .cable import Cable
from .conftest import Place

ODOMETRY = "nav_msgs/msg/Odometry"
FLOAT = "std_msgs/msg/Float64"
registry = TypeRegistry()


def made(type: str, value: Mapping[str, object]) -> Sample:
    return Sample(registry.codec(type).encode(value), type, 1, bytes(16), 0)


def values(samples: Sequence[Sample]) -> list[object]:
    return [registry.codec(one.type).decode(one.payload)["data"] for one in samples]


async def test_to_a_device(place: Place) -> None:
    """A device reads a String as its text, a number as itself, bytes as they are, and any other message as JSON."""
    graph, device = await place.graph(), place.device("robot/#")
    for topic, type, value in (
        ("/robot/name", STRING, {"data": "turtle"}),
        ("/robot/battery", FLOAT, {"data": 0.5}),
        ("/robot/raw", BYTES, {"data": b"\0\xff"}),
        ("/robot/odom", ODOMETRY, {"child_frame_id": "base"}),
    ):
        publisher = await graph.create_publisher(topic, type)
        publisher.publish(made(type, value))
    await until(lambda: len(device.got) == 4)
    assert device.got[:3] == [("robot/name", b"turtle"), ("robot/battery", b"0.5"), ("robot/raw", b"\0\xff")]
    assert json.loads(device.got[3][1])["child_frame_id"] == "base"


async def test_from_a_device(place: Place) -> None:
    """What a device publishes is a message of the type with which it is read; what does not fit is counted."""
    graph, device = await place.graph(), place.device()
    inbox = Inbox()
    await graph.create_subscription("/sensors/temp", FLOAT, QoS(), inbox)
    for payload in ("21.5", "warm", "", "\0", "1e999", "{", "-3"):
        device.publish("sensors/temp", payload)
    await inbox.wait(2)
    assert values(inbox.samples) == [21.5, -3.0]
    assert graph.drops["/sensors/temp", Undelivered.DECODE] == 5
    assert graph.fault_log.counts["value", "sensors/temp"] == 5


async def test_qos(place: Place) -> None:
    """Reliable topics have QoS 1 and others QoS 0, to a device and from it."""
    graph, device = await place.graph(), place.device("to/+")
    reliable, sensor = (
        await graph.create_publisher("/to/a", STRING),
        await graph.create_publisher("/to/b", STRING, SENSOR_DATA),
    )
    reliable.publish(sample("a"))
    sensor.publish(sample("b"))
    await until(lambda: len(device.messages) == 2)
    assert {message.topic: message.qos for message in device.messages} == {"to/a": 1, "to/b": 0}
    assert not any(message.retain for message in device.messages)


async def test_retained_by_a_device(place: Place) -> None:
    """The value that a broker keeps of a device's topic comes to latched and adopting readers, and to no others."""
    graph, device = await place.graph(), place.device()
    device.publish("state", "kept", retain=True)
    latched, adopting, volatile = Inbox(), Inbox(), Inbox()
    await graph.create_subscription("/state", STRING, QoS(), volatile)
    subscription = await graph.create_subscription("/state", STRING, None, adopting)
    await graph.create_subscription("/state", STRING, LATCHED, latched)
    await latched.wait(1)
    await adopting.wait(1)
    assert subscription.qos.transient_local
    device.publish("state", "new")
    for inbox in (latched, adopting, volatile):
        await until(lambda inbox=inbox: inbox.texts[-1:] == ["new"])
    assert (latched.texts, adopting.texts, volatile.texts) == (["kept", "new"], ["kept", "new"], ["new"])


async def test_retained_for_a_device(place: Place) -> None:
    """The last message of a transient-local publisher is kept for devices that come later."""
    graph = await place.graph()
    publisher = await graph.create_publisher("/map", STRING, LATCHED)
    publisher.publish(sample("old"))
    publisher.publish(sample("map"))
    await publisher.arrived()
    device = place.device("map")
    await until(lambda: device.got)
    assert (device.got, device.messages[0].retain) == ([("map", b"map")], True)


async def test_identity(place: Place) -> None:
    """A message keeps its origin and number from one gateway to another, so that loops end."""
    near, far = await place.graph("near"), await place.graph("far")
    inbox = Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    back = await far.create_publisher("/t", STRING)
    publisher = await near.create_publisher("/t", STRING)
    message = Sample(text("hello"), STRING, 1, b"o" * 16, 1234)
    publisher.publish(message)
    (got,) = await inbox.wait(1)
    assert (got.origin, got.seq) == (b"o" * 16, 1234)
    echoes = Inbox()
    await near.create_subscription("/t", STRING, QoS(), echoes)
    back.publish(got)
    back.publish(sample("another"))
    await echoes.wait(1)
    assert echoes.texts == ["another"]


async def test_announced(place: Place) -> None:
    """Gateways at a broker see each other with types and profiles, and no longer once one has closed."""
    near, far = await place.graph("near"), await place.graph("far")
    await near.create_publisher("/map", STRING, LATCHED)
    await near.create_subscription("/cmd", STRING, QoS(), lambda _: None)
    await until(lambda: {"/map", "/cmd"} <= far.topics().keys())
    (publisher,) = far.topics()["/map"].publishers
    assert (publisher.node, publisher.type, publisher.qos, publisher.local) == ("/near", STRING, LATCHED, False)
    assert far.nodes()["/near"].subscriptions == (("/cmd", STRING),)
    assert near.topics()["/map"].publishers[0].local
    await near.close()
    await until(lambda: not far.nodes() and not far.topics())


async def test_will(place: Place) -> None:
    """A gateway whose connection breaks is announced no longer: that is its will."""
    cable = await place.stack.enter_async_context(Cable(place.broker))
    near, far = await place.graph("near", cable.url), await place.graph("far")
    await near.create_publisher("/map", STRING)
    await until(lambda: "/map" in far.topics())
    cable.cut()
    await until(lambda: "/map" not in far.topics())
    cable.whole = True
    await until(lambda: "/map" in far.topics())


async def test_unannounced(place: Place) -> None:
    """A gateway that is told to announces nothing, and is read all the same."""
    near, far = await place.graph("near", "?announce=no"), await place.graph("far", "?announce=no")
    device, inbox = place.device("#"), Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/t", STRING)
    publisher.publish(sample("hello"))
    await inbox.wait(1)
    await until(lambda: device.got)
    assert device.got == [("t", b"hello")]


async def test_listed(place: Place) -> None:
    """Topics on which something is seen are listed by their names in ROS; those of the broker itself are not."""
    device = place.device()
    device.publish("factory/robot-1/pose", b"1,2,3", retain=True)
    graph = await place.graph(discover=("#",))
    await until(lambda: "/factory/robot_x2d_1/pose" in graph.topics())
    device.publish("live", b"\xff\0")
    device.publish("a" * 300, b"x")
    await until(lambda: "/live" in graph.topics() and graph.drops[UNLISTED, Undelivered.DECODE])
    topics = graph.topics()
    assert topics["/factory/robot_x2d_1/pose"].publishers[0].qos == LATCHED
    assert {name: info.type for name, info in topics.items()} == {
        "/factory/robot_x2d_1/pose": STRING,
        "/live": BYTES,
    }
    assert graph.look_up("topic", "/live") == topics["/live"]
    assert graph.look_up("topic", "/none") is graph.look_up("service", "/live") is None
    assert graph.counts() == (2, 0)
    await until(lambda: graph.settled)
    device.publish("factory/robot-1/pose", b"", retain=True)
    await until(lambda: "/factory/robot_x2d_1/pose" not in graph.topics())


async def test_many_topics(place: Place) -> None:
    """Of very many topics those seen longest ago are forgotten, and counted."""
    graph, device = await place.graph(discover=("many/#",)), place.device()
    await until(lambda: graph._watch is not None and graph._watch.connected)
    device.publish_all([(f"many/{number}", b"x") for number in range(MQTT_TOPICS + 100)])
    await until(lambda: graph.drops[UNLISTED, Undelivered.BACKLOG] == 100)
    assert graph.counts() == (MQTT_TOPICS, 0)
    assert "/many/_x30_" not in graph.topics()


async def test_filter_as_one_topic(place: Place) -> None:
    """All topics that match a filter are read as one ROS topic, and cannot be published as one."""
    maps = MqttMaps([MqttMap("factory/+/temp", FLOAT, name="/temps", direction="in")])
    graph, device, inbox = await place.graph(maps=maps), place.device(), Inbox()
    await graph.create_subscription("/temps", FLOAT, QoS(), inbox)
    device.publish("factory/a/temp", "1")
    device.publish("factory/b/temp", "2")
    device.publish("factory/b/c/temp", "3")
    device.publish("factory/c/temp", "4")
    await inbox.wait(3)
    assert values(inbox.samples) == [1.0, 2.0, 4.0]
    assert len({one.origin for one in inbox.samples}) == 3
    with pytest.raises(InvalidName, match="direction in"):
        await graph.create_publisher("/temps", FLOAT)
    with pytest.raises(TypeConflict):
        await graph.create_subscription("/temps", STRING, QoS(), inbox)


async def test_maps(place: Place) -> None:
    """A map gives a topic its ROS name, type and form, in both directions."""
    twist = "geometry_msgs/msg/Twist"
    maps = MqttMaps(
        [MqttMap("dev-1/drive", twist, "floats", "/cmd_vel"), MqttMap("cdr/#", STRING, "cdr", latched=True)]
    )
    graph, device, inbox = await place.graph(maps=maps), place.device("#"), Inbox()
    publisher = await graph.create_publisher("/cmd_vel", twist)
    publisher.publish(made(twist, {"linear": {"x": 0.5}}))
    await until(lambda: ("dev-1/drive", b"0.5,0.0,0.0,0.0,0.0,0.0") in device.got)
    await graph.create_subscription("/cdr/a", STRING, QoS(), inbox)
    device.publish("cdr/a", text("as it is"))
    device.publish("cdr/a", b"no CDR")
    device.publish("cdr/a", text("again"))
    await inbox.wait(2)
    assert inbox.texts == ["as it is", "again"]
    assert graph.drops["/cdr/a", Undelivered.DECODE] == 1


async def test_cdr_between_gateways(place: Place) -> None:
    """A gateway that sends CDR is understood by one that expects JSON: the message says what it is."""
    near = await place.graph("near", maps=MqttMaps([MqttMap("t", ODOMETRY, "cdr")]))
    far, inbox = await place.graph("far"), Inbox()
    await far.create_subscription("/t", ODOMETRY, QoS(), inbox)
    publisher = await near.create_publisher("/t", ODOMETRY)
    message = made(ODOMETRY, {"child_frame_id": "base"})
    publisher.publish(message)
    (got,) = await inbox.wait(1)
    assert got.payload == message.payload


async def test_another_type(place: Place) -> None:
    """A message that says that it is of another type is counted, not misread."""
    near, far, inbox = await place.graph("near"), await place.graph("far"), Inbox()
    await far.create_subscription("/t", STRING, QoS(), inbox)
    wrong, right = await near.create_publisher("/t", FLOAT), await near.create_publisher("/t", STRING)
    wrong.publish(made(FLOAT, {"data": 1.0}))
    right.publish(sample("right"))
    await inbox.wait(1)
    assert inbox.texts == ["right"]
    assert far.drops["/t", Undelivered.DECODE] == 1


async def test_large_payloads(place: Place) -> None:
    """A payload above the limit does not come; what is smaller goes on."""
    graph, device, inbox = await place.graph(max_message_bytes=100_000), place.device(), Inbox()
    await graph.create_subscription("/t", STRING, QoS(), inbox)
    device.publish("t", b"x" * 300_000)
    device.publish("t", b"x" * 100_001)
    device.publish("t", b"small")
    await inbox.wait(1)
    assert inbox.texts == ["small"]


async def test_hostile_announcements(place: Place) -> None:
    """What is no announcement is counted, and disturbs nobody."""
    near, far, device = await place.graph("near"), await place.graph("far"), place.device()
    await near.create_publisher("/good", STRING)
    for number, payload in enumerate((b"\xff", b"[]", b"{" * 1000, b'{"node": 1}', b"x" * 300_000)):
        device.publish(f"ropeway/{number:032x}", payload, retain=True)
    device.publish("ropeway/not-an-id", b"x", retain=True)
    await until(lambda: far.drops[UNLISTED, Undelivered.DECODE] == 5 and "/good" in far.topics())
    assert set(far.nodes()) == {"/near"}


async def test_no_calls(place: Place) -> None:
    """There are neither services nor actions, which is said."""
    graph = await place.graph()
    with pytest.raises(GraphUnavailable, match="neither services nor actions"):
        await graph.create_client("/add", "example_interfaces/srv/AddTwoInts")


@pytest.mark.parametrize("name", ["/_x24_SYS/broker/uptime", "/a/_x23_", "/_x2b_"])
async def test_names_of_no_topic(place: Place, name: str) -> None:
    """What no broker takes as a topic is refused, with the reason."""
    graph = await place.graph()
    with pytest.raises(InvalidName):
        await graph.create_publisher(name, STRING)


async def test_older_protocol(place: Place) -> None:
    """MQTT 3.1.1 does as well, without identities: what comes back of our own is recognised, once each."""
    near, far = await place.graph("near", "?version=3.1.1"), await place.graph("far", "?version=3.1.1")
    own, other, device = Inbox(), Inbox(), place.device()
    await near.create_subscription("/t", STRING, QoS(), own)
    await far.create_subscription("/t", STRING, QoS(), other)
    publisher = await near.create_publisher("/t", STRING)
    for value in ("a", "a", "b"):
        publisher.publish(sample(value))
    await other.wait(3)
    device.publish("t", "a")
    await other.wait(4)
    await own.wait(1)
    assert (own.texts, other.texts) == (["a"], ["a", "a", "b", "a"])
