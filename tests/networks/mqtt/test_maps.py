"""ropeway.networks.mqtt.maps: names, types and forms of topics."""

from __future__ import annotations

import pytest

from ropeway.errors import InvalidName, TypesError
from ropeway.networks.mqtt.maps import BYTES, STRING, MqttMap, MqttMaps, form_of
from ropeway.types import TypeRegistry

registry = TypeRegistry()


def test_first_that_matches() -> None:
    """The first map that matches a topic counts, and a named topic has that name alone."""
    first, second = MqttMap("a/+", name="/first", direction="in"), MqttMap("a/#", BYTES)
    maps = MqttMaps([first, second])
    assert (maps.of("a/b"), maps.of("a/b/c"), maps.of("b")) == (first, second, None)
    assert (maps.name_of("a/b"), maps.name_of("a/b/c"), maps.name_of("b")) == ("/first", "/a/b/c", "/b")
    assert maps.at("/first", "in") == ("a/+", first)
    assert maps.at("/a/b/c", "out") == ("a/b/c", second)
    assert maps.at("/b", "out") == ("b", None)
    for name, direction in (("/first", "out"), ("/a/b", "in")):
        with pytest.raises(InvalidName):
            maps.at(name, direction)


@pytest.mark.parametrize(
    ("type", "form", "payload"),
    [
        (STRING, "text", b"x"),
        ("std_msgs/msg/Float64", "text", b"21.5"),
        ("std_msgs/msg/Bool", "text", b"true"),
        (BYTES, "raw", b"\0\xff"),
        ("std_msgs/msg/ByteMultiArray", "raw", b"\0\xff"),
        ("std_msgs/msg/Empty", "json", b"{}"),
    ],
)
def test_forms_by_type(type: str, form: str, payload: bytes) -> None:
    """Without a map the type says how a payload is written, both ways alike."""
    name, found = form_of(None, type, registry)
    assert name == form
    ((_, cdr),) = found.messages(payload)
    assert found.text(cdr) == payload


def test_form_of_a_map() -> None:
    """The form of a map counts before that of the type, and has to fit it."""
    assert form_of(MqttMap("a", STRING, "cdr"), STRING, registry)[0] == "cdr"
    assert form_of(MqttMap("a", STRING), STRING, registry)[0] == "text"
    with pytest.raises(TypesError):
        form_of(MqttMap("a", STRING, "raw"), STRING, registry)
