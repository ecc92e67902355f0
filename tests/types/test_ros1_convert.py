"""Messages between CDR and ROS 1's bytes."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from ropeway.errors import DecodeError
from ropeway.types import TypeRegistry
from ropeway.types.ros1_types import Ros1Types


@pytest.fixture(scope="module")
def types() -> Ros1Types:
    return Ros1Types(TypeRegistry())


def test_alike(types: Ros1Types) -> None:
    """Fields that differ in the spelling of their names, or a header in its seq, do not need values."""
    for name in ("std_msgs/msg/String", "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "nav_msgs/msg/Odometry"):
        assert types.converter(name).alike, name
    for name in ("sensor_msgs/msg/Range", "visualization_msgs/msg/MarkerArray"):
        assert not types.converter(name).alike, name


def test_stamped(types: Ros1Types) -> None:
    """A message that begins with a header has its seq in the first four bytes."""
    assert types.converter("sensor_msgs/msg/Image").stamped
    assert not types.converter("std_msgs/msg/Header").stamped
    assert not types.converter("tf2_msgs/msg/TFMessage").stamped


def test_bytes(types: Ros1Types) -> None:
    """A header is written as ROS 1 does it."""
    codec = types.registry.codec("std_msgs/msg/Header")
    cdr = codec.encode({"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "map"})
    raw = types.converter("std_msgs/msg/Header").to_ros1(cdr)
    assert raw == struct.pack("<IIII", 0, 1, 2, 3) + b"map"
    assert types.converter("std_msgs/msg/Header").from_ros1(raw) == cdr


def test_by_name(types: Ros1Types) -> None:
    """Fields that only one side has are left out, or get their default; the others arrive, through all depths."""
    type = "visualization_msgs/msg/MarkerArray"
    codec, converter = types.registry.codec(type), types.converter(type)
    marker: dict[str, Any] = {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "map"},
        "ns": "x",
        "points": [{"x": 1.0, "y": 2.0, "z": 3.0}],
        "lifetime": {"sec": 5, "nanosec": 6},
        "text": "hello",
        "texture_resource": "only in ROS 2",
    }
    raw = converter.to_ros1(codec.encode({"markers": [marker]}))
    (got,) = codec.decode(converter.from_ros1(raw))["markers"]
    assert {name: got[name] for name in marker} == marker | {"texture_resource": ""}


@pytest.mark.parametrize("type", ["std_msgs/msg/String", "sensor_msgs/msg/Range"])
def test_bad_bytes(types: Ros1Types, type: str) -> None:
    """Bytes that are too short, too long or no CDR at all are a ``DecodeError``, on both ways."""
    converter = types.converter(type)
    good = converter.to_ros1(types.registry.codec(type).encode({}))
    for raw in (b"\xff\xff\xff\xff", good[:-1], good + b"x"):
        with pytest.raises(DecodeError):
            converter.from_ros1(raw)
    with pytest.raises(DecodeError):
        converter.to_ros1(b"\0\1\0\0\xff\xff\xff\xff")


def test_parts_of_a_service(types: Ros1Types) -> None:
    """Requests and responses have layouts of their own; an empty one is no byte in ROS 1."""
    empty = types.converter("std_srvs/srv/Trigger_Request")
    assert empty.to_ros1(types.registry.codec("std_srvs/srv/Trigger_Request").encode({})) == b""
    assert empty.from_ros1(b"")[:4] == b"\0\1\0\0"
