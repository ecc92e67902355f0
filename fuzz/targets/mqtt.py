"""What comes from a broker: names of topics, announcements of gateways, and payloads with what stands beside them."""

from __future__ import annotations

from collections import Counter
from typing import Final

from paho.mqtt.client import MQTTMessage

from fuzz.target import Target
from ropeway.errors import InvalidName, TypesError
from ropeway.graph.base import Sample, Undelivered
from ropeway.networks.mqtt.discovery import MqttDiscovery
from ropeway.networks.mqtt.maps import MqttMaps, form_of
from ropeway.networks.mqtt.names import check_filter, matches, mqtt_topic, ros_name
from ropeway.networks.mqtt.presence import Announced, pack_announcement, parse_announcement
from ropeway.networks.mqtt.wire import PublishProperties, read_message
from ropeway.qos import LATCHED
from ropeway.types import TypeRegistry

__all__ = ["TARGETS"]

_STRING: Final = "std_msgs/msg/String"
_FORMS: Final = [
    form_of(None, type, TypeRegistry())[1]
    for type in (_STRING, "std_msgs/msg/Float64", "std_msgs/msg/UInt8MultiArray", "geometry_msgs/msg/Twist")
]


def _name(data: bytes) -> None:
    topic = data.decode(errors="replace")
    try:
        name = ros_name(topic)
    except InvalidName:
        name = ""
    if name and topic and not topic.startswith("$SYS") and not any(c in topic for c in "+#\0"):
        assert mqtt_topic(name) == topic
    filter, _, rest = topic.partition(" ")
    assert matches(check_filter(filter), rest) in (True, False)


def _announcement(data: bytes) -> None:
    found = parse_announcement(data)
    if found is not None:
        again = parse_announcement(pack_announcement(found.node, found.endpoints))
        assert again is not None
        assert again.endpoints == found.endpoints
        discovery = MqttDiscovery("fuzz", MqttMaps(), lambda event: None, Counter[tuple[str, Undelivered]]())
        discovery.announce("1", found)
        discovery.announce("1", None)
        assert not discovery.names()


def _payload(data: bytes) -> None:
    """A form by the first byte, an identity by what follows up to a line's end, then the payload."""
    identity, _, payload = data[1:].partition(b"\n")
    message = MQTTMessage(1, b"t")
    message.payload = payload
    message.properties = PublishProperties(_STRING, "text", None).of(Sample(b"", _STRING, 1, bytes(16), 1))
    del message.properties.UserProperty
    message.properties.UserProperty = ("ropeway", identity.decode(errors="replace"))
    found = read_message(message, "fuzz")
    assert found is not None
    assert len(found.origin) == 16
    assert found.seq > 0
    form = _FORMS[data[0] % len(_FORMS)] if data else _FORMS[0]
    for _, cdr in form.messages(found.payload):
        form.text(cdr)


def _announced() -> list[bytes]:
    ends = (Announced("publisher", "a/b", _STRING, LATCHED), Announced("subscription", "c/+", _STRING, LATCHED))
    return [pack_announcement("/robot", ends), b'{"node": "/n", "endpoints": [["p", "a", "b", {}]]}']


TARGETS: Final = {
    "mqtt-names": Target(
        _name,
        (ValueError,),
        lambda: [b"factory/robot-1/odom", b"a/+/# a//b", b"_x2d_/_x_", b"0x00158d", b"$SYS/broker"],
        (b"_x", b"_x5f_", b"//", b"+", b"#"),
    ),
    "mqtt-announcements": Target(_announcement, (), _announced, (b'"endpoints"', b'["p",', b'"durability"')),
    "mqtt-payloads": Target(
        _payload,
        (TypesError,),
        lambda: [bytes((n,)) + b"0" * 32 + b" 12 std_msgs/msg/String\n" + b'{"linear": {"x": 1}}' for n in range(4)],
        (b" 1 ", b"std_msgs/msg/String", b"NaN"),
    ),
}
