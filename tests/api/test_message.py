"""Messages as programs have them."""

from __future__ import annotations

import time
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ropeway import DecodeError, TypeConflict, TypedMessage, ValueMismatch
from ropeway.api.message import MessageType
from ropeway.types import TypeRegistry

REGISTRY = TypeRegistry()
STRING = MessageType(REGISTRY, "std_msgs/String")
TWIST = MessageType(REGISTRY, "geometry_msgs/msg/Twist")
IMAGE = MessageType(REGISTRY, "sensor_msgs/msg/Image")
PATH = MessageType(REGISTRY, "nav_msgs/msg/Path")


def made(type: MessageType, value: object) -> TypedMessage:
    return type.message(type.encode(value), topic="/x")


def test_is_a_mapping() -> None:
    """A message is a mapping of its fields, knows its type and topic, and is decoded when it is looked at."""
    message = made(TWIST, {"linear": {"x": 0.5}})
    assert (message.type, message.topic, list(message), len(message)) == (
        "geometry_msgs/msg/Twist",
        "/x",
        ["linear", "angular"],
        2,
    )
    assert message["linear"] == {"x": 0.5, "y": 0.0, "z": 0.0}
    assert dict(message) == message.to_dict()
    assert repr(made(STRING, {"data": "hi"})) == "<std_msgs/msg/String {'data': 'hi'}>"
    assert len(repr(made(STRING, {"data": "x" * 1000}))) < 300


def test_other_forms() -> None:
    """A message is also had as a new dict, as an object with attributes, and as the JSON of rosbridge."""
    message = made(PATH, {"poses": [{"pose": {"position": {"x": 3.0}}}]})
    assert message.to_object().poses[0].pose.position.x == 3.0
    assert message.to_dict() is not message.to_dict()
    assert made(STRING, {"data": "hi"}).to_json() == '{"data":"hi"}'


def test_bytes_and_arrays() -> None:
    """Arrays of bytes are bytes, arrays of numbers are numpy arrays."""
    image = made(IMAGE, {"data": b"\x01\x02"})
    assert image["data"] == b"\x01\x02"
    info = made(MessageType(REGISTRY, "sensor_msgs/msg/LaserScan"), {"ranges": np.array([1.0, 2.0], np.float32)})
    assert isinstance(info["ranges"], np.ndarray)
    assert info["ranges"].tolist() == [1.0, 2.0]


@dataclass
class Vector:
    x: float = 0.0
    y: float = 0.0


@dataclass(slots=True)
class SlottedTwist:
    linear: Any
    angular: Any


class RosTwist:
    """As rclpy has it: the fields are properties, with their names in a method."""

    __slots__ = ("_linear",)

    def __init__(self) -> None:
        self._linear = SimpleNamespace(x=1.0)

    @property
    def linear(self) -> Any:
        return self._linear

    @staticmethod
    def get_fields_and_field_types() -> dict[str, str]:
        return {"linear": "geometry_msgs/Vector3"}


@pytest.mark.parametrize(
    "value",
    [
        {"linear": {"x": 1.0}},
        {"linear": Vector(1.0)},
        SimpleNamespace(linear=Vector(1.0)),
        SlottedTwist(Vector(1.0), {}),
        RosTwist(),
        made(TWIST, {"linear": {"x": 1.0}}),
        made(TWIST, {"linear": {"x": 1.0}}).raw,
        bytearray(made(TWIST, {"linear": {"x": 1.0}}).raw),
        made(TWIST, {"linear": {"x": 1.0}}).to_object(),
        made(TWIST, {"linear": {"x": 1.0}}).to_dict(),
    ],
    ids=["dict", "nested object", "object", "slots", "rclpy", "message", "bytes", "bytearray", "to_object", "to_dict"],
)
def test_what_is_taken(value: object) -> None:
    """Mappings, objects, messages and CDR bytes all become the same message; fields left out get their defaults."""
    assert made(TWIST, value)["linear"] == {"x": 1.0, "y": 0.0, "z": 0.0}


def test_nothing_is_a_message_of_defaults() -> None:
    """None stands for a message whose fields all have their defaults."""
    assert made(STRING, None)["data"] == ""


def test_lists_of_objects() -> None:
    """Objects in lists are messages, too."""
    poses = [SimpleNamespace(pose=SimpleNamespace(position=Vector(2.0)))]
    assert made(PATH, {"poses": poses})["poses"][0]["pose"]["position"]["x"] == 2.0


def test_header_gets_the_time() -> None:
    """A header without stamp gets the present time, one with a stamp keeps it."""
    before = int(time.time())
    assert made(IMAGE, {"header": {"frame_id": "map"}})["header"]["stamp"]["sec"] >= before
    assert made(IMAGE, {"header": {"stamp": {"sec": 0, "nanosec": 0}}})["header"]["stamp"]["sec"] == 0


def test_equality() -> None:
    """Messages are equal if their types and bytes are, also as keys, and equal to a dict of the same values."""
    one, same, other = made(STRING, {"data": "a"}), made(STRING, {"data": "a"}), made(STRING, {"data": "b"})
    assert one == same
    assert len({one, same, other}) == 2
    assert one == {"data": "a"}
    scan = made(MessageType(REGISTRY, "sensor_msgs/msg/LaserScan"), {"ranges": [1.0, 2.0]})
    assert scan == MessageType(REGISTRY, scan.type).message(scan.raw)


def looped() -> dict[str, Any]:
    value: dict[str, Any] = {}
    value["linear"] = value
    return value


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        ({"data": 5}, ValueMismatch, "data"),
        ({"dta": "x"}, ValueMismatch, "dta"),
        ("hi", ValueMismatch, "str is not a message; give a mapping, an object with these fields, or CDR bytes"),
        (5, ValueMismatch, "int is not a message"),
        ([1], ValueMismatch, "list is not a message"),
        (looped(), ValueMismatch, "contains itself"),
        (b"", DecodeError, "not with 00 01"),
        (b"\0\1\0\0\xff\xff\xff\xff", DecodeError, "std_msgs/msg/String"),
        (made(TWIST, None), TypeConflict, "geometry_msgs/msg/Twist"),
    ],
)
def test_what_is_refused(value: object, error: type[Exception], text: str) -> None:
    """What is no message of the type is refused with an error that says why."""
    with pytest.raises(error, match=text):
        STRING.encode(value)


def test_bytes_that_are_no_message() -> None:
    """Bytes that are no message are found out when a field is looked at; the message itself can still be shown."""
    message = STRING.message(b"\0\1\0\0\xff\xff\xff\xff")
    with pytest.raises(DecodeError):
        message["data"]
    assert "not a std_msgs/msg/String" in repr(message)
