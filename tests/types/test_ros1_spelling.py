"""Messages as peers of ROS 1 write them."""

from __future__ import annotations

import json
import random
from typing import Any

import cbor2
import pytest

from ropeway.errors import DecodeError, TypesError, ValueMismatch
from ropeway.types import TypeRegistry
from ropeway.types.ros1_spelling import Ros1Spelling
from ropeway.types.ros1_types import Ros1Types
from ropeway.types.stores import store_table

from .messages import random_message

REGISTRY = TypeRegistry()
SPELLING = Ros1Spelling(Ros1Types(REGISTRY))


def said(type: str, value: dict[str, Any]) -> Any:
    """What a peer of ROS 1 gets of what another said."""
    codec = SPELLING.codec(type)
    return json.loads(codec.json(codec.from_json(value)))


@pytest.mark.parametrize(
    ("type", "value", "got"),
    [
        (
            "std_msgs/Header",
            {"seq": 1, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "map"},
            {"seq": 0, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "map"},
        ),
        ("std_msgs/Header", {"stamp": {"sec": 1}}, {"seq": 0, "stamp": {"secs": 1, "nsecs": 0}, "frame_id": ""}),
        ("std_msgs/Byte", {"data": -5}, {"data": -5}),
        ("std_msgs/Char", {"data": 250}, {"data": 250}),
        ("std_msgs/Time", {"data": {"secs": 4_000_000_000, "nsecs": 1}}, None),
        ("std_msgs/Duration", {"data": {"secs": -1, "nsecs": 5}}, None),
        ("std_msgs/ColorRGBA", {"r": 1.0}, {"r": 1.0, "g": 0.0, "b": 0.0, "a": 0.0}),
    ],
)
def test_spelling(type: str, value: dict[str, Any], got: dict[str, Any] | None) -> None:
    """Headers have a number, times secs and nsecs, bytes a sign; ROS 2's spelling is taken, too."""
    assert said(type, value) == (got or value)


def test_capital_names() -> None:
    """CameraInfo has the names of ROS 1, in what is taken and in what is given."""
    got = said("sensor_msgs/CameraInfo", {"D": [0.1], "K": [1.0] * 9})
    assert (got["D"], got["K"]) == ([0.1], [1.0] * 9)
    assert "d" not in got
    cdr = SPELLING.codec("sensor_msgs/CameraInfo").from_json({"D": [0.5]})
    assert list(REGISTRY.codec("sensor_msgs/CameraInfo").decode(cdr)["d"]) == [0.5]


def test_now() -> None:
    """A header without a stamp gets the time, as does a time that is "now"."""
    codec = SPELLING.codec("geometry_msgs/PoseStamped")
    cdr = codec.from_json({"header": {"frame_id": "map"}}, now_ns=lambda: 5_000_000_007)
    assert json.loads(codec.json(cdr))["header"] == {"seq": 0, "stamp": {"secs": 5, "nsecs": 7}, "frame_id": "map"}
    codec = SPELLING.codec("std_msgs/Time")
    assert json.loads(codec.json(codec.from_json({"data": "now"}, now_ns=lambda: 3_000_000_000))) == {
        "data": {"secs": 3, "nsecs": 0}
    }


@pytest.mark.parametrize(
    ("type", "value", "reason"),
    [
        ("std_msgs/Byte", {"data": -129}, r"\[-128, 127\]"),
        ("std_msgs/Header", {"sequence": 1}, "does not have a field sequence"),
        ("std_msgs/Time", {"data": {"secs": "x"}}, "whole numbers"),
    ],
)
def test_misfits(type: str, value: dict[str, Any], reason: str) -> None:
    """A value that fits neither spelling is refused in the words of rosbridge."""
    with pytest.raises(ValueMismatch, match=reason):
        SPELLING.codec(type).from_json(value)


@pytest.mark.parametrize("name", sorted(store_table("noetic")))
def test_every_type_of_noetic(name: str) -> None:
    """Every message of Noetic comes back from its raw bytes and from its JSON and CBOR."""
    codec = SPELLING.codec(name)
    cdr = REGISTRY.codec(name).encode(random_message(REGISTRY, name, random.Random(name), finite=True))
    raw = codec.raw(cdr)
    again = codec.from_raw(raw)
    assert codec.raw(again) == raw
    in_cbor = cbor2.loads(cbor2.dumps(codec.cbor(again)))
    for copy in (codec.from_json(json.loads(codec.json(again))), codec.from_cbor(in_cbor)):
        assert codec.raw(copy) == raw


def test_raw_bytes_are_checked() -> None:
    """Raw bytes that are not of their type are refused, in ROS 1 as in ROS 2."""
    for bad in (b"", b"\xff\xff\xff\xff", b"\x01\0\0\0xx", b"\0\1\0\0\2\0\0\0x\0"):
        with pytest.raises(DecodeError):
            SPELLING.codec("std_msgs/String").from_raw(bad)
    for bad in (b"\0\1\0\0", b"\0\1\0\0\xff\xff\xff\x7f", b"\0\1\0\0\2\0\0\0xy"):
        with pytest.raises(TypesError):
            REGISTRY.codec("std_msgs/String").from_raw(bad)


def test_descriptions() -> None:
    """Names have two parts, typedefs and texts are those of ROS 1."""
    assert SPELLING.name("std_msgs/msg/String") == "std_msgs/String"
    assert SPELLING.name("std_msgs/String") == "std_msgs/String"
    header = SPELLING.typedefs("geometry_msgs/PoseStamped")[1]
    assert (header["fieldnames"], header["fieldtypes"]) == (["seq", "stamp", "frame_id"], ["uint32", "time", "string"])
    assert SPELLING.text("std_msgs/Header") == "uint32 seq\ntime stamp\nstring frame_id\n"
