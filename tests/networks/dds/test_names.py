"""How ROS names become DDS names, and back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import InvalidTypeName
from ropeway.networks.dds.names import (
    Name,
    NameKind,
    action_of,
    action_of_feedback,
    dds_service_topics,
    dds_topic,
    dds_type,
    demangle,
    demangle_type,
    is_hidden,
    is_of_action,
)


@pytest.mark.parametrize(
    ("ros", "dds"),
    [
        ("std_msgs/msg/String", "std_msgs::msg::dds_::String_"),
        ("std_msgs/String", "std_msgs::msg::dds_::String_"),
        ("example_interfaces/srv/AddTwoInts", "example_interfaces::srv::dds_::AddTwoInts_"),
        ("turtle/action/Rotate", "turtle::action::dds_::Rotate_"),
    ],
)
def test_types(ros: str, dds: str) -> None:
    """A ROS type has the DDS name that ROS 2 gives it, also in its short spelling."""
    assert dds_type(ros) == dds
    assert dds_type(demangle_type(dds)) == dds


def test_parts_of_a_service() -> None:
    """The request and the response of a service are types of their own."""
    assert dds_type("p/srv/Add", "_Request") == "p::srv::dds_::Add_Request_"


@pytest.mark.parametrize("name", ["", "String", "a/b/c/d", "a b/msg/C"])
def test_bad_types(name: str) -> None:
    """What is no type name is refused."""
    with pytest.raises(InvalidTypeName):
        dds_type(name)


@pytest.mark.parametrize("name", ["std_msgs::msg::String", "HelloWorld", "a::msg::dds_::B", ""])
def test_foreign_types_stay(name: str) -> None:
    """A DDS type that is not of ROS keeps its name."""
    assert demangle_type(name) == name


def test_topics() -> None:
    """A topic comes back from DDS as it went."""
    assert dds_topic("/ns/scan") == "rt/ns/scan"
    assert demangle("rt/ns/scan", "sensor_msgs::msg::dds_::LaserScan_") == Name(
        NameKind.TOPIC, "/ns/scan", "sensor_msgs/msg/LaserScan"
    )


def test_services() -> None:
    """Both topics of a service show the service's name and type."""
    request, reply = dds_service_topics("/ns/add")
    assert (request, reply) == ("rq/ns/addRequest", "rr/ns/addReply")
    assert demangle(request, "p::srv::dds_::Add_Request_") == Name(NameKind.REQUEST, "/ns/add", "p/srv/Add")
    assert demangle(reply, "p::srv::dds_::Add_Response_") == Name(NameKind.REPLY, "/ns/add", "p/srv/Add")


@pytest.mark.parametrize(
    "topic", ["ros_discovery_info", "rt", "rt/", "rx/a", "DCPSTopic", "rq/addReply", "rqRequest", ""]
)
def test_foreign_topics(topic: str) -> None:
    """Topics that ROS did not name are foreign and keep their names."""
    assert demangle(topic).kind is NameKind.FOREIGN
    assert demangle(topic).name == topic


def test_actions() -> None:
    """The service that takes goals tells of the action; the other parts of an action are hidden."""
    assert action_of("/fly/_action/send_goal", "p/action/Fly_SendGoal") == ("/fly", "p/action/Fly")
    assert action_of("/fly/_action/get_result", "p/action/Fly_GetResult") is None
    assert action_of("/add", "p/srv/Add") is None
    assert action_of_feedback("/fly/_action/feedback", "p/action/Fly_FeedbackMessage") == ("/fly", "p/action/Fly")
    assert action_of_feedback("/fly/_action/status", "action_msgs/msg/GoalStatusArray") is None
    assert action_of_feedback("/_action/feedback", "x") is None
    assert is_of_action("/fly/_action/status")
    assert not is_of_action("/fly/action")
    assert is_hidden("/fly/_action/status")
    assert not is_hidden("/fly_status")


@given(st.text(max_size=40), st.text(max_size=40))
def test_any_text(topic: str, type: str) -> None:
    """Whatever a peer calls its topics and types, there is a name for it."""
    assert isinstance(demangle(topic, type), Name)
