"""Values that a person wrote, cast as ``ros2`` casts them."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ropeway.errors import ValueMismatch
from ropeway.types import TypeRegistry
from ropeway.types.cast import cast

REGISTRY = TypeRegistry()


def sent(type: str, value: Any) -> dict[str, Any]:
    """The message that is made of a value."""
    codec = REGISTRY.codec(f"std_msgs/msg/{type}" if "/" not in type else type)
    return codec.decode(codec.from_json(cast(codec.type, value, REGISTRY.definition)))


@pytest.mark.parametrize(
    ("type", "given", "right"),
    [
        ("String", 5, "5"),
        ("String", 1.5, "1.5"),
        ("String", True, "True"),
        ("Bool", 1, True),
        ("Bool", 0.0, False),
        ("Bool", "no", False),
        ("Bool", "True", True),
        ("Int32", 1.0, 1),
        ("Int32", -1.7, -1),
        ("Int32", True, 1),
        ("Int32", "0x10", 16),
        ("UInt64", "1_000", 1000),
        ("Int8", "-5", -5),
        ("Float64", "1e3", 1000.0),
        ("Float64", "-inf", -math.inf),
        ("Float32", "Infinity", math.inf),
        ("Float32", 3, 3.0),
        ("Float32", False, 0.0),
    ],
)
def test_scalars(type: str, given: Any, right: Any) -> None:
    """A scalar is cast to the type of its field."""
    message = sent(type, {"data": given})
    assert message == {"data": right}
    assert message["data"].__class__ is right.__class__


def test_nan() -> None:
    """The text nan is a number for a field of floats."""
    assert math.isnan(sent("Float64", {"data": "nan"})["data"])
    assert math.isnan(sent("Float32MultiArray", {"data": ["nan", 1]})["data"][0])


def test_nested() -> None:
    """Fields of fields and elements of arrays are cast alike, and times may be given as floats."""
    message = sent(
        "trajectory_msgs/msg/JointTrajectory",
        {
            "header": {"stamp": {"sec": 1.0, "nanosec": "5"}, "frame_id": 7},
            "joint_names": [1, "b"],
            "points": [{"positions": [1, "2"], "time_from_start": {"sec": 2.0}}],
        },
    )
    assert message["header"] == {"stamp": {"sec": 1, "nanosec": 5}, "frame_id": "7"}
    assert message["joint_names"] == ["1", "b"]
    assert message["points"][0]["positions"].tolist() == [1.0, 2.0]
    assert message["points"][0]["time_from_start"] == {"sec": 2, "nanosec": 0}


@pytest.mark.parametrize(
    ("type", "value"),
    [
        ("Int32", {"data": "five"}),
        ("Int32", {"data": math.nan}),
        ("UInt8", {"data": 256.0}),
        ("Bool", {"data": "maybe"}),
        ("String", {"data": None}),
        ("String", {"data": ["a"]}),
        ("Float64", {"data": "far"}),
        ("Int32MultiArray", {"data": [1.5]}),
        ("Int32MultiArray", {"data": 1}),
        ("String", {"dta": "x"}),
        ("Header", {"stamp": 3}),
        ("String", []),
    ],
)
def test_what_cannot_be_cast(type: str, value: Any) -> None:
    """What cannot be cast is left for the codec, which refuses it and names the field."""
    with pytest.raises(ValueMismatch):
        sent(type, value)
