"""``topic list`` and ``topic info`` as text."""

from __future__ import annotations

from ropeway.cli.topic.info import endpoint_block, info_text
from ropeway.cli.topic.list_ import hidden, verbose_lines
from ropeway.graph.base import EndpointInfo, TopicInfo
from ropeway.qos import LATCHED, SENSOR_DATA, QoS

TYPE = "std_msgs/msg/String"
TALKER = EndpointInfo("publisher", "/chatter", TYPE, QoS(depth=7), bytes(range(16)), "/ns/talker", "RIHS01_00")
LISTENER = EndpointInfo("subscription", "/chatter", TYPE, SENSOR_DATA, gateway="cloud")
OURS = EndpointInfo("subscription", "/chatter", TYPE, SENSOR_DATA, local=True)
CHATTER = TopicInfo("/chatter", (TYPE,), (TALKER,), (LISTENER, LISTENER, OURS))


def test_verbose_list() -> None:
    """Publishers and subscribers are counted apart, ours left out."""
    assert verbose_lines([CHATTER, TopicInfo("/idle", (TYPE,), (), (OURS,))]) == (
        "Published topics:\n * /chatter [std_msgs/msg/String] 1 publisher\n\n"
        "Subscribed topics:\n * /chatter [std_msgs/msg/String] 2 subscribers\n"
    )


def test_hidden_names() -> None:
    """A part that starts with an underscore hides a name."""
    assert hidden("/_x/y")
    assert hidden("/a/_action/status")
    assert not hidden("/a_b")


def test_info() -> None:
    """Type and counts stand on three lines."""
    assert info_text(CHATTER) == "Type: std_msgs/msg/String\nPublisher count: 1\nSubscription count: 2"
    both = TopicInfo("/x", (TYPE, "std_msgs/msg/Int8"))
    assert info_text(both).startswith("Type: ['std_msgs/msg/String', 'std_msgs/msg/Int8']\n")


def test_verbose_info() -> None:
    """Each end has a block with node, type hash and QoS; what is unknown is said to be."""
    assert endpoint_block(TALKER) == (
        "Node name: talker\nNode namespace: /ns\nTopic type: std_msgs/msg/String\nTopic type hash: RIHS01_00\n"
        "Endpoint type: PUBLISHER\nGID: 00.01.02.03.04.05.06.07.08.09.0a.0b.0c.0d.0e.0f\nQoS profile:\n"
        "  Reliability: RELIABLE\n  History (Depth): KEEP_LAST (7)\n  Durability: VOLATILE\n"
        "  Lifespan: Infinite\n  Deadline: Infinite"
    )
    listener = endpoint_block(LISTENER)
    assert "Node name: _NODE_NAME_UNKNOWN_\n" in listener
    assert listener.endswith("\nGateway: cloud")
    assert "  Reliability: BEST_EFFORT\n" in listener
    late = endpoint_block(
        EndpointInfo("publisher", "/t", TYPE, QoS(durability="transient_local", lifespan_s=0.5), node="/t")
    )
    assert "  Lifespan: 500000000 nanoseconds\n" in late
    assert "Node namespace: /\n" in late
    assert LATCHED.depth == 1
    untold = endpoint_block(EndpointInfo("publisher", "/t", TYPE, QoS(depth=0)))
    assert "  History (Depth): UNKNOWN\n" in untold
    assert info_text(CHATTER, verbose=True).count("Endpoint type:") == 3
