"""Values as they are written on the command line."""

from __future__ import annotations

from typing import Any

import pytest
import typer

from ropeway.cli.values import fitted, parse_values
from ropeway.errors import ValueMismatch
from ropeway.types import TypeRegistry


def made(registry: TypeRegistry, type: str, text: str) -> dict[str, Any]:
    """The message that a text on the command line makes."""
    codec = registry.codec(type)
    return codec.decode(codec.from_json(fitted(registry, type, parse_values(text))))


def test_values_in_yaml(capsys: pytest.CaptureFixture[str]) -> None:
    """Values are YAML, and a mapping."""
    assert parse_values("{data: 'on', n: [1, 2.5]}") == {"data": "on", "n": [1, 2.5]}
    assert parse_values("data: on") == {"data": "on"}
    assert parse_values("") == {}
    for wrong in ("[1]", "{data: ", "3"):
        with pytest.raises(typer.Exit):
            parse_values(wrong)
    assert "the values need to be a mapping" in capsys.readouterr().err


def test_a_message_is_made_of_what_was_typed(registry: TypeRegistry) -> None:
    """What is typed is cast to the types of the fields, in messages, requests and goals."""
    assert made(registry, "std_msgs/msg/String", "{data: 5}") == {"data": "5"}
    assert made(registry, "std_srvs/srv/SetBool_Request", "{data: 1}") == {"data": True}
    assert made(registry, "example_interfaces/action/Fibonacci_Goal", "{order: 5.0}") == {"order": 5}


def test_an_automatic_header_is_stamped(registry: TypeRegistry) -> None:
    """``auto`` for a header is the time of sending, wherever the header stands."""
    for type, text in (("sensor_msgs/msg/Joy", "header: auto"), ("nav_msgs/msg/Path", "{poses: [{header: auto}]}")):
        message = made(registry, type, text)
        header = message["header"] if "poses" not in message else message["poses"][0]["header"]
        assert header["stamp"]["sec"] > 0


def test_what_fits_no_field_is_an_error(registry: TypeRegistry) -> None:
    """A value that cannot be cast is refused with the name of its field."""
    with pytest.raises(ValueMismatch, match="data"):
        made(registry, "std_msgs/msg/Int32", "{data: five}")
