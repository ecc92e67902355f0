from __future__ import annotations

import pytest

from ropeway.networks.iort.maps import Maps, TopicMap, names_of, ros_name

TWIST = "geometry_msgs/msg/Twist"


@pytest.mark.parametrize(
    ("system", "topic", "name"),
    [
        ("PEPPER", "cmd_vel", "/PEPPER/cmd_vel"),
        ("PEPPER", "arm/left", "/PEPPER/arm/left"),
        ("robot-1", "battery.level", "/robot_1/battery_level"),
        ("1st", "2nd", "/_1st/_2nd"),
        ("ROS", "chatter", "/chatter"),
        ("A", "//b//", "/A/b"),
    ],
)
def test_ros_name(system: str, topic: str, name: str) -> None:
    """A topic of nodes has a name that ROS allows."""
    assert ros_name(system, topic) == name


@pytest.mark.parametrize(
    ("name", "key"), [("/a/b", ("a", "b")), ("/a/b/c", ("a", "b/c")), ("/chatter", ("ROS", "chatter"))]
)
def test_names_of(name: str, key: tuple[str, str]) -> None:
    """The first part of a ROS name is the system; a name of one part belongs to none."""
    assert names_of(name) == key
    assert ros_name(*key) == name


def test_first_fits() -> None:
    """Of several maps that fit the first counts; without any the topic is as it comes."""
    special = TopicMap("PEPPER", "cmd_vel", TWIST, "floats")
    general = TopicMap("PEPPER", "*")
    maps = Maps([special, general])
    assert maps.of("PEPPER", "cmd_vel") is special
    assert maps.of("PEPPER", "battery") is general
    assert maps.of("ALICE", "battery") is None
    assert maps.at("/ALICE/battery", "in") == [("ALICE", "battery", None)]
    assert maps.at("/PEPPER/battery", "in") == [("PEPPER", "battery", general)]


def test_directions() -> None:
    """What only goes one way is not there for the other."""
    maps = Maps([TopicMap("A", "up", direction="in"), TopicMap("A", "down", direction="out")])
    assert [topic for _, topic, _ in maps.at("/A/up", "in")] == ["up"]
    assert maps.at("/A/up", "out") == []
    assert maps.at("/A/down", "in") == []


def test_one_name_for_many() -> None:
    """Several topics of nodes may be one topic of ROS."""
    move, turn = TopicMap("ALICE", "MOVE", TWIST, name="/cmd_vel"), TopicMap("ALICE", "TURN", TWIST, name="/cmd_vel")
    maps = Maps([move, turn])
    assert maps.at("/cmd_vel", "out") == [("ALICE", "MOVE", move), ("ALICE", "TURN", turn)]
    assert maps.at("/ALICE/MOVE", "out") == [("ALICE", "MOVE", None)]  # a name that no map gives
