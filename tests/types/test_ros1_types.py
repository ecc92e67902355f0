"""Definitions, sums and texts of ROS 1."""

from __future__ import annotations

import subprocess

import pytest

from ropeway.errors import InvalidDefinition, TypeConflict, UnknownType
from ropeway.types import TypeRegistry
from ropeway.types.ros1_types import Ros1Types
from tests.networks.ros1.network import HAS_ROSPY, PYTHON

PACKAGES = [
    *("std_msgs", "sensor_msgs", "geometry_msgs", "nav_msgs", "actionlib_msgs", "actionlib", "rosgraph_msgs"),
    *("diagnostic_msgs", "std_srvs", "trajectory_msgs", "visualization_msgs", "shape_msgs", "stereo_msgs", "tf2_msgs"),
]

LIST = """
import importlib, sys
for package in sys.argv[1:]:
    for kind in ("msg", "srv"):
        try:
            module = importlib.import_module(package + "." + kind)
        except ImportError:
            continue
        for name in dir(module):
            found = getattr(module, name)
            if hasattr(found, "_md5sum") and (kind == "msg" or hasattr(found, "_request_class")):
                print(kind, found._type, found._md5sum)
"""

DYNAMIC = """
import sys, genpy.dynamic
type, text = sys.argv[1], sys.stdin.read()
made = genpy.dynamic.generate_dynamic(type, text)[type]
print(made._md5sum, " ".join(made.__slots__))
"""

THING = """std_msgs/Header header
my_robot/Part[] parts
uint8 KIND=3
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: my_robot/Part
string name
time made
"""


@pytest.fixture
def types() -> Ros1Types:
    return Ros1Types(TypeRegistry())


@pytest.mark.skipif(not HAS_ROSPY, reason="needs ROS 1's message packages, which .ci/run installs on Debian")
def test_sums_of_debian(types: Ros1Types) -> None:
    """The sums of all messages and services that Debian has are those that ROS 1 computed."""
    listed = subprocess.run([PYTHON, "-c", LIST, *PACKAGES], capture_output=True, text=True, timeout=60, check=True)
    lines = [line.split() for line in listed.stdout.splitlines()]
    wrong = []
    for kind, name, md5 in lines:
        if name == "tf2_msgs/LookupTransformAction":
            continue  # it only joins the three others
        found = types.message(name) if kind == "msg" else types.service(name)
        if (found.name, found.md5) != (name, md5):
            wrong.append(name)
    assert not wrong
    assert len(lines) > 120


@pytest.mark.parametrize(
    ("name", "md5"),
    [
        ("std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1"),
        ("std_msgs/Header", "2176decaecbce78abc3b96ef049fabed"),
        ("sensor_msgs/Image", "060021388200f6f0f447d0fcd9c64743"),
        ("sensor_msgs/CameraInfo", "c9a58c1b0b154e0e6da7578cb991d214"),
        ("tf2_msgs/TFMessage", "94810edda583a504dfda3829e70d7eec"),
    ],
)
def test_known_sums(types: Ros1Types, name: str, md5: str) -> None:
    """Well-known messages have their well-known sums."""
    assert types.message(name).md5 == md5


@pytest.mark.skipif(not HAS_ROSPY, reason="needs ROS 1's genpy, which .ci/run installs on Debian")
@pytest.mark.parametrize(
    "name", ["sensor_msgs/CameraInfo", "visualization_msgs/Marker", "nav_msgs/Odometry", "a/Thing"]
)
def test_full_text(types: Ros1Types, name: str) -> None:
    """ROS 1 makes the same type of a full text."""
    types.registry.add_text(
        "a/msg/Thing", "string<=5 name\nint32[<=3] some\nbuiltin_interfaces/Duration d\nint8 X=-3\n"
    )
    found = types.message(name)
    command = [PYTHON, "-c", DYNAMIC, name]
    made = subprocess.run(command, input=found.text, capture_output=True, text=True, timeout=60, check=True)
    md5, *fields = made.stdout.split()
    assert md5 == found.md5
    assert fields == [field.name for field in types.definition(name.replace("/", "/msg/")).fields]


def test_derived(types: Ros1Types) -> None:
    """A type that only ROS 2 has loses bounds and defaults, and gets ROS 1's time."""
    types.registry.add_text("a/msg/Thing", "string<=5 name 'x'\nint32[<=3] some\nbuiltin_interfaces/Time t\n")
    found = types.message("a/msg/Thing")
    assert (found.name, found.text, found.sure) == ("a/Thing", "string name\nint32[] some\ntime t\n", False)


def test_parts_of_actions(types: Ros1Types) -> None:
    """The parts of an action are messages of ROS 1."""
    found = types.message("example_interfaces/msg/FibonacciActionGoal")
    assert found.text.startswith(
        "std_msgs/Header header\nactionlib_msgs/GoalID goal_id\nexample_interfaces/FibonacciGoal"
    )
    assert "MSG: example_interfaces/FibonacciGoal\nint32 order\n" in found.text


def test_unknown(types: Ros1Types) -> None:
    """A type that nobody knows is unknown."""
    for name in ("no/msg/Such", "no/msg/SuchActionGoal"):
        with pytest.raises(UnknownType):
            types.message(name)
    with pytest.raises(UnknownType):
        types.service("no/srv/Such")


def test_learns(types: Ros1Types) -> None:
    """What a publisher tells is known from then on, here and to the registry."""
    with pytest.raises(TypeConflict, match="sum"):
        types.learn("my_robot/msg/Thing", "0" * 32, THING)
    assert not types.registry.has("my_robot/msg/Thing")
    with pytest.raises(TypeConflict) as caught:
        types.learn("my_robot/msg/Thing", "1" * 32, THING)
    md5 = caught.value.offered.rsplit(" ", 1)[1]
    assert types.learn("my_robot/msg/Thing", md5, THING)
    assert not types.learn("my_robot/msg/Thing", md5, THING)
    assert types.message("my_robot/msg/Thing").md5 == md5
    assert types.message("my_robot/msg/Thing").sure
    assert [field.name for field in types.registry.definition("my_robot/msg/Part").fields] == ["name", "made"]


@pytest.mark.parametrize(
    "text", ["bool a\n" * 20_000, "int32 A=1\n" * 20_000, "#\n" * 200_000], ids=["fields", "constants", "long"]
)
def test_large_definitions_are_not_parsed(types: Ros1Types, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """What a publisher tells is refused by its size before any of it is parsed."""
    monkeypatch.setattr("ropeway.types.ros1_types.parse_sections", None)
    with pytest.raises(InvalidDefinition, match=r"more than 2000 fields|characters; at most"):
        types.learn("my_robot/msg/Thing", "0" * 32, text)


def test_knows_better(types: Ros1Types) -> None:
    """A publisher cannot change what ROS 1 itself defines."""
    assert not types.learn("std_msgs/msg/String", "0" * 32, "int32 data\n")
    assert types.message("std_msgs/String").md5 == "992ce8a1687cec8c8bd883ec73ca41d1"


def test_teaches(types: Ros1Types) -> None:
    """A message that only ROS 1 has becomes known to the registry."""
    assert not types.registry.has("rosgraph_msgs/msg/Log")
    types.teach("rosgraph_msgs/msg/Log")
    assert types.registry.codec("rosgraph_msgs/msg/Log").default()["msg"] == ""
