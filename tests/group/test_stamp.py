"""ropeway.group.stamp: the time in the header of a message."""

from __future__ import annotations

import pytest

from ropeway.group.stamp import stamp_reader
from ropeway.types import TypeRegistry

REGISTRY = TypeRegistry()


def image(sec: int, nanosec: int) -> bytes:
    return REGISTRY.codec("sensor_msgs/msg/CompressedImage").encode(
        {"header": {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": "camera"}, "format": "h264", "data": b"x"}
    )


def test_equal_stamps() -> None:
    """Two messages of different types with equal stamps give the same bytes, others do not."""
    read = stamp_reader(REGISTRY, "sensor_msgs/msg/CompressedImage")
    answer = REGISTRY.codec("geometry_msgs/msg/PointStamped").encode({"header": {"stamp": {"sec": 5, "nanosec": 7}}})
    assert read(image(5, 7)) == stamp_reader(REGISTRY, "geometry_msgs/msg/PointStamped")(answer)
    assert read(image(5, 7)) != read(image(5, 8))


@pytest.mark.parametrize("type", ["std_msgs/msg/String", "no_such/msg/Type", "std_msgs/msg/Empty"])
def test_none(type: str) -> None:
    """A type without a header, or one that is not known, has no stamp."""
    assert stamp_reader(REGISTRY, type)(b"\0\1\0\0" + bytes(64)) is None


def test_zero_and_short() -> None:
    """A stamp that was not set, and a message that is cut off, give none."""
    read = stamp_reader(REGISTRY, "sensor_msgs/msg/CompressedImage")
    assert read(image(0, 0)) is None
    assert read(b"\0\1\0\0\1") is None
