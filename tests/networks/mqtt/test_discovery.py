"""ropeway.networks.mqtt.discovery: what there is at a broker."""

from __future__ import annotations

from collections import Counter

from ropeway.graph.base import GraphEvent, Undelivered
from ropeway.limits import MQTT_PRESENCES, MQTT_TOPIC_AGE_S
from ropeway.networks.mqtt.discovery import UNLISTED, MqttDiscovery
from ropeway.networks.mqtt.maps import BYTES, STRING, MqttMap, MqttMaps
from ropeway.networks.mqtt.presence import Announced, Announcement
from ropeway.networks.mqtt.wire import Received
from ropeway.qos import DEFAULT, LATCHED, QoS


class Found:
    """A discovery with a clock of its own, and what it told."""

    def __init__(self, *maps: MqttMap) -> None:
        self.now_s = 0.0
        self.events: list[str] = []
        self.drops: Counter[tuple[str, Undelivered]] = Counter()
        self.all = MqttDiscovery("mqtt", MqttMaps(maps), self._note, self.drops, lambda: self.now_s)

    def _note(self, event: GraphEvent) -> None:
        self.events.append(f"{'+' if event.discovered else '-'}{event.kind[0]} {event.name}")

    def see(self, topic: str, payload: bytes = b"x", *, retained: bool = False) -> None:
        self.all.see(Received(topic, payload, retained, bytes(16), 1))


def announced(*topics: str, qos: QoS = DEFAULT, type: str = STRING) -> Announcement:
    return Announcement("/n", tuple(Announced("publisher", topic, type, qos) for topic in topics))


def test_likely_type() -> None:
    """A topic of which nobody tells the type is a text or bytes, as its payload is."""
    found = Found(MqttMap("mapped", "std_msgs/msg/Float64"))
    cut = b"x" + "é".encode() * 4000  # a character on the edge of what is looked at
    for number, payload in enumerate((b"text", cut, b"\xff", b"a\0", b"x" * 5000 + b"\xff")):
        found.see(f"t{number}", payload)
    found.see("mapped", b"1")
    types = [found.all.of(f"/t{number}")[0].type for number in range(5)]
    assert types == [STRING, STRING, BYTES, BYTES, STRING]
    assert found.all.of("/mapped")[0].type == "std_msgs/msg/Float64"


def test_seen_and_announced() -> None:
    """A topic that is announced is not listed a second time for what is seen on it."""
    found = Found()
    found.see("a")
    found.all.announce("1", announced("a", qos=LATCHED))
    found.see("a")
    assert [info.qos for info in found.all.of("/a")] == [LATCHED]
    assert found.all.offered("/a") == [LATCHED]
    found.all.announce("1", announced("a", "b"))
    assert found.all.offered("/a") == [DEFAULT]
    found.all.announce("1", None)
    assert found.all.names() == set()
    assert found.all.nodes() == {}
    found.see("a")
    assert found.all.names() == {"/a"}


def test_retained_and_taken_away() -> None:
    """A retained message makes a topic latched, an empty one takes the topic away."""
    found = Found()
    found.see("a")
    assert found.all.offered("/a") == [DEFAULT]
    found.see("a", retained=True)
    assert found.all.offered("/a") == [LATCHED]
    found.see("a")
    assert found.all.offered("/a") == [LATCHED]
    found.see("a", b"")
    assert found.all.offered("/a") == []
    assert found.events == ["+p /a", "-p /a", "+p /a", "-p /a"]


def test_age() -> None:
    """Topics on which nothing came for long are forgotten, unless the broker keeps a value of them."""
    found = Found()
    for topic, retained in (("old", False), ("kept", True), ("busy", False)):
        found.see(topic, retained=retained)
    found.now_s = MQTT_TOPIC_AGE_S
    found.see("busy")
    found.all.expire()
    assert found.all.names() == {"/kept", "/busy"}


def test_bounds() -> None:
    """Announcements of more gateways than there can be are counted."""
    found = Found()
    for number in range(MQTT_PRESENCES + 5):
        found.all.announce(f"{number}", announced("a"))
    assert found.drops[UNLISTED, Undelivered.BACKLOG] == 5
    found.all.announce("0", announced("b"))
    assert found.all.names() == {"/a", "/b"}
    found.all.clear()
    assert found.all.names() == set()


def test_hostile_names() -> None:
    """Topics without a name in ROS are counted once each, and those of the broker are left out."""
    found = Found()
    for _ in range(3):
        found.see("x" * 300)
        found.see("$SYS/broker/uptime")
        found.see("$share/x")
    assert (found.all.names(), found.drops) == (set(), {(UNLISTED, Undelivered.DECODE): 1})
    found.all.announce("1", announced("y" * 300, "good"))
    assert found.all.names() == {"/good"}
