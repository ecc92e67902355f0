"""What generated readers give for each flavour."""

from __future__ import annotations

import base64
import json
from typing import Any

import cbor2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.types import TypeRegistry
from ropeway.types.layout import CODES, Planner
from ropeway.types.reader import FLAVOURS, make_reader
from ropeway.types.values import Short

from .messages import probe_registry

REGISTRY = probe_registry()


def read(name: str, flavour: str, message: dict[str, Any]) -> Any:
    """What a reader gives for a message."""
    raw = REGISTRY.codec(name).encode(message)
    value, end = make_reader(Planner(REGISTRY.definition).plan(name), flavour)(raw, 4, len(raw))
    assert end == len(raw)
    return value


def test_objects_are_plain() -> None:
    """The object flavour has bytes, read-only little-endian numpy arrays, and lists."""
    value = read("probe/msg/Sequences", "object", {"uint8_values": [1], "int32_values": [2], "bool_values": [True]})
    assert value["uint8_values"] == b"\1"
    assert value["bool_values"] == [True]
    assert isinstance(value["int32_values"], np.ndarray)
    assert (value["int32_values"].dtype, value["int32_values"].flags.writeable) == (np.dtype("<i4"), False)
    assert value["float64_values"].shape == (0,)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_fields_stand_in_order(flavour: str) -> None:
    """Every flavour has all fields in the order of the definition, nested as it says."""
    value = read("sensor_msgs/msg/Imu", flavour, {"angular_velocity": {"y": 0.5}})
    assert list(value) == [field.name for field in REGISTRY.definition("sensor_msgs/msg/Imu").fields]
    assert value["angular_velocity"] == {"x": 0.0, "y": 0.5, "z": 0.0}
    assert value["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}


def test_large_fixed_arrays() -> None:
    """A large array of fixed size is read as well as a small one."""
    registry = TypeRegistry()
    registry.add_text("t/msg/T", "float64[1000] a\nuint8[1000] b\nbool[1000] c\nint8[1000] d\n")
    codec = registry.codec("t/T")
    cdr = codec.encode({"a": np.arange(1000.0), "c": [True] * 1000, "d": [-1] * 1000})
    assert codec.decode(cdr)["a"][999] == 999.0
    assert codec.json(cdr).count(b"true") == 1000
    assert codec.cbor(cdr)["a"][999] == 999.0
    assert len(codec.rosgw(cdr)["a"]) == 8000
    assert codec.from_ros1(codec.ros1(cdr)) == cdr


def test_lengths_are_checked_first() -> None:
    """A length beyond the bytes that follow is refused before anything is made of it."""
    for name in ("probe/msg/Sequences", "nav_msgs/msg/Path", "sensor_msgs/msg/PointCloud2", "std_msgs/msg/String"):
        reader = make_reader(Planner(REGISTRY.definition).plan(name), "object")
        raw = bytes(4) + b"\xff" * 64
        with pytest.raises(Short):
            reader(raw, 4, len(raw))


def test_empty_elements_are_bounded() -> None:
    """ROS 1's empty messages, which take no bytes, cannot be many."""
    registry = TypeRegistry()
    registry.add_text("t/msg/T", "std_msgs/Empty[] a\n")
    reader = make_reader(Planner(registry.definition, "ros1").plan("t/msg/T"), "object")
    assert reader(b"\2\0\0\0", 0, 4) == ({"a": [{}, {}]}, 4)
    with pytest.raises(Short):
        reader(b"\xff\xff\xff\xff", 0, 4)


def test_empty_elements_are_bounded_in_all() -> None:
    """Those of all sequences of a message are counted together, and those of another message are not."""
    registry = TypeRegistry()
    registry.add_text("t/msg/T", "std_msgs/Empty[] a\n")
    registry.add_text("t/msg/U", "T[] b\nstd_msgs/Empty[2] c\n")
    reader = make_reader(Planner(registry.definition, "ros1").plan("t/msg/U"), "object")
    half = (32_000).to_bytes(4, "little")
    two, three = b"\2\0\0\0" + 2 * half, b"\3\0\0\0" + 3 * half
    for _ in range(3):
        value, _ = reader(two, 0, len(two))
        assert [len(each["a"]) for each in value["b"]] == [32_000, 32_000]
        with pytest.raises(Short):
            reader(three, 0, len(three))


def test_tags() -> None:
    """The cbor flavour tags sequences of numbers by their type."""
    value = read("sensor_msgs/msg/LaserScan", "cbor", {"ranges": [1.0]})
    assert value["ranges"] == cbor2.CBORTag(85, b"\0\0\x80?")


def test_long_integers_as_texts() -> None:
    """One flavour of JSON has integers of 64 bits as texts wherever they stand, and is the other one otherwise."""
    registry = TypeRegistry()
    registry.add_text("t/msg/In", "int64 a\nuint64[2] b\nint32 c\n")
    registry.add_text("t/msg/T", "In[] d\nint64[] e\nuint64[100] f\nfloat64 g\nint64[<=2] h\n")
    codec = registry.codec("t/T")
    inner = {"a": -(2**63), "b": [2**64 - 1, 1], "c": 7}
    cdr = codec.encode({"d": [inner], "e": [2**53 + 1] * 100, "g": 1.5, "h": [1]})
    texts = codec.with_long_texts()
    value = json.loads(texts.json(cdr))
    assert value["d"] == [{"a": "-9223372036854775808", "b": ["18446744073709551615", "1"], "c": 7}]
    assert value["e"] == ["9007199254740993"] * 100
    assert (value["f"], value["g"], value["h"]) == (["0"] * 100, 1.5, ["1"])
    assert json.loads(codec.json(cdr))["d"] == [inner]
    assert (texts.long_texts, codec.long_texts) == (True, False)


@given(base=st.sampled_from((*CODES, "string", "wstring", "Inner")), count=st.integers(1, 4), lone=st.booleans())
def test_arrays_of_any_length_stay_arrays(base: str, count: int, lone: bool) -> None:
    """A fixed array is an array in every flavour, of one element too, alone or beside other fields."""
    registry = TypeRegistry()
    registry.add_text("probe/msg/Inner", "int8 x\n")
    registry.add_text("probe/msg/Fixed", f"{base}[{count}] values\n" + ("" if lone else "float64 last\n"))
    codec = registry.codec("probe/msg/Fixed")
    cdr = codec.encode({})
    values = json.loads(codec.json(cdr))["values"]
    assert len(base64.b64decode(values) if isinstance(values, str) else values) == count
    for message in (codec.decode(cdr), codec.cbor(cdr), codec.rosgw(cdr)):
        assert hasattr(message["values"], "__len__")
        assert codec.encode(message) == cdr
    assert codec.from_ros1(codec.ros1(cdr)) == cdr
