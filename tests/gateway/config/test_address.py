"""How graphs are written in a configuration."""

from __future__ import annotations

import pytest

from ropeway.gateway.config.address import parse_graph, parse_link, parse_listen


@pytest.mark.parametrize(
    "text",
    [
        "dds:0",
        "dds:5?interface=lo",
        "ros2",
        "ros2:0",
        "ros2:232",
        "auto",
        "zenoh",
        "zenoh?domain=5",
        "zenoh:tcp/robot:7447,tls/[::1]:7448?ca=/etc/ca.pem&distro=humble",
        "zenoh:peer",
        "memory:x",
        "ros1",
        "ros1:http://robot:11311",
        "ros1://robot:11311",
    ],
)
def test_graphs(text: str) -> None:
    """Every kind of graph is taken as it is written."""
    assert parse_graph(text) == text


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("dds", "expected dds:0"),
        ("ros2:x", "expected ros2 or ros2:0"),
        ("ros2:233", "a ROS domain from 0 to 232"),
        ("dds:233", "a DDS domain from 0 to 232"),
        ("auto:1", "expected auto"),
        ("ros1:robot", "expected ros1 or ros1:http://host:11311"),
        ("ros3:0", "did you mean"),
        ("memory:", "expected memory:name"),
        ("zenoh:robot:7447", "expected zenoh, zenoh:tcp/host:7447 or zenoh:peer"),
        ("zenoh:tcp/robot", "write tcp/host:7447"),
        ("zenoh?domain=400", "from 0 to 232"),
    ],
)
def test_refused(text: str, said: str) -> None:
    """What is no graph is refused with what was expected."""
    with pytest.raises(ValueError, match=said):
        parse_graph(text)


def test_addresses_of_remotes() -> None:
    """What is no address of a remote is told all that are, the overlay among them; a listener is not told of it."""
    with pytest.raises(ValueError, match=r"ws://host:port or .* or overlay, got"):
        parse_link("http://foo")
    with pytest.raises(ValueError, match='did you mean "overlay"'):
        parse_link("overlay2://x")
    with pytest.raises(ValueError, match="expected") as refused:
        parse_listen("http://foo")
    assert "overlay" not in str(refused.value)
