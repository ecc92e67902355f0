"""ropeway.networks.mqtt.names: topics of a broker and names of ROS."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ropeway.errors import InvalidName
from ropeway.networks.mqtt.names import check_filter, check_topic, matches, mqtt_topic, ros_name

_LEVELS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="/+#\0"), max_size=8)
_CODED = st.lists(st.sampled_from(["_", "x", "2d", "5f", "-", "_x", "_x2d_", "_x5f_", "0", "a"]), max_size=8).map(
    "".join
)
_PLAIN = st.from_regex(r"(/[a-z_][a-z0-9_]{0,6}){1,4}", fullmatch=True)


@pytest.mark.parametrize(
    ("topic", "name"),
    [
        ("factory/robot1/odom", "/factory/robot1/odom"),
        ("factory/robot-1/odom", "/factory/robot_x2d_1/odom"),
        ("zigbee/0x00158d/set", "/zigbee/_x30_x00158d/set"),
        ("/a//b/", "/_x_/a/_x_/b/_x_"),
        ("température", "/temp_xe9_rature"),
        ("a b", "/a_x20_b"),
        ("odom_x1", "/odom_x1"),
        ("a_x2d_b", "/a_x5f_x2d_b"),
        ("_x_", "/_x5f_x_"),
    ],
)
def test_names(topic: str, name: str) -> None:
    """A topic has one name in ROS, which leads back to it."""
    assert ros_name(topic) == name
    assert mqtt_topic(name) == topic


@given(st.lists(_LEVELS | _CODED, min_size=1, max_size=4).map("/".join))
def test_every_topic_has_its_own_name(topic: str) -> None:
    """Every topic that is not too long has a name that leads back to it alone."""
    assume(topic and not topic.startswith("$SYS"))
    try:
        name = ros_name(topic)
    except InvalidName as error:
        assert "at most 256 characters" in str(error)
        return
    assert mqtt_topic(name) == topic


@given(_PLAIN.filter(lambda name: "_x" not in name))
def test_every_plain_name_has_its_topic(name: str) -> None:
    """An ordinary ROS name is a topic without its first slash."""
    assert mqtt_topic(name) == name[1:]
    assert ros_name(name[1:]) == name


@pytest.mark.parametrize("name", ["/_x2b_", "/a/_x23_", "/_x0_b", "/_x24_SYS/broker/uptime"])
def test_names_that_no_broker_takes(name: str) -> None:
    """A name that would be a filter, or the broker's own topic, is refused."""
    with pytest.raises(InvalidName):
        mqtt_topic(name)


def test_long_topics() -> None:
    """A topic above the limit of MQTT is refused."""
    with pytest.raises(InvalidName, match="at most"):
        check_topic("é" * 40_000)


@pytest.mark.parametrize("text", ["", "a/#/b", "a#", "a+/b", "a/+b", "a\0", "#a", "é" * 40_000])
def test_bad_filters(text: str) -> None:
    """A filter that breaks a rule of MQTT is refused, with the rule."""
    with pytest.raises(ValueError, match=r"\+ stands|# stands|expected a topic"):
        check_filter(text)


@pytest.mark.parametrize(
    ("filter", "topic", "fits"),
    [
        ("a/b", "a/b", True),
        ("a/+", "a/b", True),
        ("a/+", "a/b/c", False),
        ("a/+/c", "a//c", True),
        ("a/#", "a", True),
        ("a/#", "a/b/c", True),
        ("#", "a/b", True),
        ("+/+", "a", False),
        ("#", "$SYS/broker", False),
        ("+/broker", "$SYS/broker", False),
        ("$SYS/#", "$SYS/broker", True),
    ],
)
def test_matching(filter: str, topic: str, fits: bool) -> None:
    """A filter matches as a broker matches it."""
    assert check_filter(filter) == filter
    assert matches(filter, topic) is fits
