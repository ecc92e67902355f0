"""Messages as text: the forms that ``ros2 topic`` prints."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.cli.topic.render import Picked, Style, as_csv, as_python, as_yaml, pick, shown
from ropeway.types import TypeRegistry
from ropeway.types.definition import FieldType

ODOMETRY = "nav_msgs/msg/Odometry"
SCAN = "sensor_msgs/msg/LaserScan"
IMAGE = "sensor_msgs/msg/Image"


def decoded(registry: TypeRegistry, type: str, **values: Any) -> dict[str, Any]:
    """A message that went through CDR."""
    codec = registry.codec(type)
    return codec.decode(codec.encode(values))


def text(registry: TypeRegistry, type: str, message: dict[str, Any], field: str = "") -> str:
    """Its YAML."""
    return as_yaml(shown(registry, pick(registry, type, message, field), Style()), Style())


def test_yaml_of_a_message(registry: TypeRegistry) -> None:
    """Fields stand in their order, nested ones indented, numbers and texts as YAML has them."""
    message = decoded(
        registry, "geometry_msgs/msg/PointStamped", header={"stamp": {"sec": 3}, "frame_id": "map"}, point={"x": 1.5}
    )
    assert text(registry, "geometry_msgs/msg/PointStamped", message) == (
        "header:\n  stamp:\n    sec: 3\n    nanosec: 0\n  frame_id: map\npoint:\n  x: 1.5\n  y: 0.0\n  z: 0.0\n"
    )


def test_long_arrays_and_strings_are_cut(registry: TypeRegistry) -> None:
    """What is longer than the limit ends with three dots."""
    message = decoded(registry, SCAN, header={"frame_id": "abcdef"}, ranges=[1.0, 2.0, 3.0, 4.0])
    cut = shown(registry, pick(registry, SCAN, message, ""), Style(truncate=3))
    assert cut["ranges"] == [1.0, 2.0, 3.0, "..."]
    assert cut["header"]["frame_id"] == "abc..."
    whole = shown(registry, pick(registry, SCAN, message, ""), Style(truncate=None))
    assert whole["ranges"] == [1.0, 2.0, 3.0, 4.0]


def test_pixels_are_numbers(registry: TypeRegistry) -> None:
    """Bytes are shown as a list of numbers, cut like any other."""
    message = decoded(registry, IMAGE, data=bytes(range(200)))
    assert shown(registry, pick(registry, IMAGE, message, "data"), Style()) == [*range(128), "..."]


def test_no_arr_and_no_str(registry: TypeRegistry) -> None:
    """Arrays and strings are described instead, in the words of ``ros2 topic echo``."""
    style = Style(no_arr=True, no_str=True)
    image = shown(registry, pick(registry, IMAGE, decoded(registry, IMAGE, encoding="rgb8", data=bytes(6)), ""), style)
    assert image["data"] == "<sequence type: uint8, length: 6>"
    assert image["encoding"] == "<string length: <4>>"
    odometry = shown(registry, pick(registry, ODOMETRY, decoded(registry, ODOMETRY), "pose"), style)
    assert odometry["covariance"] == "<array type: double[36]>"
    path = decoded(registry, "nav_msgs/msg/Path", poses=[{}, {}])
    poses = pick(registry, "nav_msgs/msg/Path", path, "poses")
    assert shown(registry, poses, style) == "<sequence type: geometry_msgs/msg/PoseStamped, length: 2>"


def test_fields_by_path(registry: TypeRegistry) -> None:
    """A path leads through messages and arrays."""
    message = decoded(registry, "nav_msgs/msg/Path", poses=[{}, {"pose": {"position": {"y": 7.0}}}])
    assert pick(registry, "nav_msgs/msg/Path", message, "poses[1].pose.position.y").value == 7.0
    assert pick(registry, "nav_msgs/msg/Path", message, "").value is message
    assert text(registry, "nav_msgs/msg/Path", message, field="poses[1].pose.position") == "x: 0.0\ny: 7.0\nz: 0.0\n"


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("pose.positon", "has no field 'positon'"),
        ("pose.covariance[36]", "past the end"),
        ("pose[0]", "not an array"),
        ("child_frame_id.x", "has no fields"),
        ("pose covariance", "not a field path"),
    ],
)
def test_wrong_paths(registry: TypeRegistry, path: str, words: str) -> None:
    """A path that leads nowhere says where it ends."""
    with pytest.raises(LookupError, match=words):
        pick(registry, ODOMETRY, decoded(registry, ODOMETRY), path)


def test_csv(registry: TypeRegistry) -> None:
    """All values stand in order with commas between them."""
    message = decoded(registry, "std_msgs/msg/Header", stamp={"sec": 1, "nanosec": 2}, frame_id="map")
    assert as_csv(shown(registry, pick(registry, "std_msgs/msg/Header", message, ""), Style())) == "1,2,map"
    assert as_csv([1.5, True]) == "1.5,True"


def test_python_form(registry: TypeRegistry) -> None:
    """``pub`` shows what it sends as Python would."""
    message = decoded(registry, "std_msgs/msg/String", data="hi")
    assert as_python(registry, "std_msgs/msg/String", message, Style()) == "std_msgs.msg.String(data='hi')"
    twist = decoded(registry, "geometry_msgs/msg/Twist", linear={"x": 0.5})
    assert as_python(registry, "geometry_msgs/msg/Twist", twist, Style()).startswith(
        "geometry_msgs.msg.Twist(linear=geometry_msgs.msg.Vector3(x=0.5, y=0.0, z=0.0), "
    )
    path = decoded(registry, "nav_msgs/msg/Path", poses=[{}])
    assert "poses=[geometry_msgs.msg.PoseStamped(header=" in as_python(registry, "nav_msgs/msg/Path", path, Style())


def test_flow_style() -> None:
    """Flow style puts everything on one line."""
    assert as_yaml({"a": [1, {"b": "x"}]}, Style(flow=True)) == "{a: [1, {b: x}]}\n"


def test_every_known_type_can_be_shown(registry: TypeRegistry) -> None:
    """The default message of every type has YAML, CSV and Python forms."""
    for name in registry.names("msg"):
        message = registry.codec(name).default()
        value = shown(registry, Picked(message, FieldType(name)), Style())
        assert as_yaml(value, Style())
        assert as_csv(value) is not None
        assert as_python(registry, name, message, Style()).startswith(name.replace("/", "."))
