"""ropeway.types.frames: frames of any message under other names."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import DecodeError, UnknownType
from ropeway.types import TypeRegistry
from ropeway.types.frame_names import FrameNames
from ropeway.types.frames import _paths, _rewriter, _splices, frame_renamer

REGISTRY = TypeRegistry()
PREFIX = FrameNames("robot1/")
TYPES = [
    ("sensor_msgs/msg/Image", {"height": 2, "encoding": "rgb8", "data": [1, 2, 3]}),
    ("sensor_msgs/msg/PointCloud2", {"fields": [{"name": "x", "count": 1}], "data": [1, 2], "is_dense": True}),
    ("sensor_msgs/msg/CompressedImage", {"format": "jpeg", "data": [1, 2, 3]}),
    ("sensor_msgs/msg/Imu", {"orientation": {"w": 0.5}, "linear_acceleration": {"z": 9.81}}),
    ("sensor_msgs/msg/Joy", {"axes": [0.5], "buttons": [1, 0]}),
    ("geometry_msgs/msg/PoseStamped", {"pose": {"position": {"x": 1.0}}}),
]


def header(name: str) -> dict[str, Any]:
    return {"stamp": {"sec": 3, "nanosec": 4}, "frame_id": name}


@pytest.mark.parametrize(("type", "values"), TYPES)
@given(
    name=st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20),
    prefix=st.text("abc/", min_size=1, max_size=9),
)
def test_exchanged_in_the_bytes(type: str, values: dict[str, Any], name: str, prefix: str) -> None:
    """What is exchanged in the bytes is what reading and writing the message gives, of any length of the names."""
    names = FrameNames(prefix)
    definition = REGISTRY.definition(type)
    assert _splices(REGISTRY, definition)
    payload = REGISTRY.codec(type).from_json({"header": header(name), **values})
    whole = _rewriter(REGISTRY.codec(type), names, _paths(REGISTRY, definition))(payload)
    assert frame_renamer(REGISTRY, type, names)(payload) == whole
    assert REGISTRY.codec(type).decode(whole)["header"]["frame_id"] == names.renamed(name)


@pytest.mark.parametrize("type", ["nav_msgs/msg/OccupancyGrid", "sensor_msgs/msg/CameraInfo"])
def test_what_another_shift_would_break(type: str) -> None:
    """A message whose later values need a greater alignment than the first is written again."""
    assert not _splices(REGISTRY, REGISTRY.definition(type))
    payload = REGISTRY.codec(type).from_json({"header": header("abc")})
    renamed = REGISTRY.codec(type).decode(frame_renamer(REGISTRY, type, PREFIX)(payload))
    assert renamed["header"]["frame_id"] == "robot1/abc"


def test_frames_anywhere() -> None:
    """Frames are renamed in lists, in nested messages, and as children."""
    transform = {"header": header("base"), "child_frame_id": "camera"}
    payload = REGISTRY.codec("tf2_msgs/msg/TFMessage").from_json({"transforms": [transform, transform]})
    renamed = REGISTRY.codec("tf2_msgs/msg/TFMessage").decode(
        frame_renamer(REGISTRY, "tf2_msgs/msg/TFMessage", PREFIX)(payload)
    )
    found = [(one["header"]["frame_id"], one["child_frame_id"]) for one in renamed["transforms"]]
    assert found == [("robot1/base", "robot1/camera")] * 2
    odometry = REGISTRY.codec("nav_msgs/msg/Odometry")
    payload = odometry.from_json(
        {"header": header("odom"), "child_frame_id": "/base", "twist": {"covariance": [1.0] * 36}}
    )
    message = odometry.decode(frame_renamer(REGISTRY, "nav_msgs/msg/Odometry", PREFIX)(payload))
    assert (message["header"]["frame_id"], message["child_frame_id"]) == ("robot1/odom", "robot1/base")
    assert message["twist"]["covariance"][35] == 1.0


@pytest.mark.parametrize(
    ("names", "old", "new"),
    [
        (PREFIX, "base", "robot1/base"),
        (PREFIX, "/base", "robot1/base"),
        (PREFIX, "map", "map"),
        (PREFIX, "/map", "/map"),
        (PREFIX, "", ""),
        (PREFIX, "robot1/base", "robot1/base"),
        (FrameNames(removed="robot1/"), "robot1/base", "base"),
        (FrameNames(removed="robot1/"), "robot2/base", "robot2/base"),
        (FrameNames(removed="robot1/"), "robot1/", "robot1/"),
        (FrameNames("b/", "a/"), "a/base", "b/base"),
        (FrameNames("b/", "a/"), "a/map", "map"),
        (FrameNames("b/", kept=("odom",)), "odom", "odom"),
        (FrameNames("b/", kept=("odom",)), "map", "b/map"),
    ],
)
def test_names(names: FrameNames, old: str, new: str) -> None:
    """A prefix is put before and taken away; shared frames, empty names and those that have it stay."""
    assert names.renamed(old) == new


def test_nothing_to_rename() -> None:
    """A message without frames, or whose frame keeps its name, is passed on as the same bytes."""
    twist = REGISTRY.codec("geometry_msgs/msg/Twist").default()
    payload = REGISTRY.codec("geometry_msgs/msg/Twist").encode(twist)
    assert frame_renamer(REGISTRY, "geometry_msgs/msg/Twist", PREFIX)(payload) is payload
    for type in ("sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"):
        payload = REGISTRY.codec(type).from_json({"header": header("map")})
        assert frame_renamer(REGISTRY, type, PREFIX)(payload) is payload


def test_big_endian() -> None:
    """A big-endian message is renamed in its own order."""
    name = b"abc\0"
    payload = b"\0\0\0\0" + struct.pack(">iII", 3, 4, len(name)) + name + struct.pack(">II", 2, 0) + b"\0" * 20
    renamed = frame_renamer(REGISTRY, "sensor_msgs/msg/Image", PREFIX)(payload)
    assert renamed[:2] == b"\0\0"
    assert renamed[16:27] == b"robot1/abc\0"
    assert struct.unpack_from(">II", renamed, 28) == (2, 0)


@given(st.binary(max_size=60))
@pytest.mark.parametrize("type", ["sensor_msgs/msg/Image", "tf2_msgs/msg/TFMessage"])
def test_any_bytes(type: str, payload: bytes) -> None:
    """Bytes that are no message are refused, and nothing else is raised."""
    rename: Callable[[bytes], bytes] = frame_renamer(REGISTRY, type, PREFIX)
    try:
        rename(b"\0\1\0\0" + payload)
        rename(payload)
    except DecodeError:
        pass


def test_unknown_type() -> None:
    """A type that nobody knows cannot be renamed."""
    with pytest.raises(UnknownType):
        frame_renamer(REGISTRY, "nope/msg/Nope", PREFIX)
