"""What is made of the master's state."""

from __future__ import annotations

from ropeway.networks.ros1.snapshot import Ros1Snapshot, State

TYPES = {
    "/chatter": "std_msgs/msg/String",
    "/move/goal": "nav/msg/MoveActionGoal",
    "/move/cancel": "actionlib_msgs/msg/GoalID",
    "/move/status": "actionlib_msgs/msg/GoalStatusArray",
    "/move/feedback": "nav/msg/MoveActionFeedback",
    "/move/result": "nav/msg/MoveActionResult",
}
SERVER = {
    "publishers": {f"/move/{topic}": ["/mover"] for topic in ("status", "feedback", "result")},
    "subscribers": {f"/move/{topic}": ["/mover"] for topic in ("goal", "cancel")},
}


def picture() -> Ros1Snapshot:
    return Ros1Snapshot("ros1:test", lambda: "/us", lambda topic, node: None)


def test_events() -> None:
    """What comes and goes is told once; what is ours is not."""
    seen = picture()
    state = State({"/chatter": ["/talker", "/us"]}, {"/chatter": ["/us"]}, {"/add": ["/adder"]}, TYPES)
    assert {str(event) for event in seen.update(state)} == {
        "ros1:test: node /talker publishes /chatter (std_msgs/msg/String)",
        "ros1:test: node /talker has appeared",
        "ros1:test: node /adder has appeared",
    }
    state.service_types["/add"] = "x/srv/Add"
    assert [str(event) for event in seen.update(state)] == ["ros1:test: node /adder offers service /add (x/srv/Add)"]
    assert not seen.update(state)
    assert all(not event.discovered for event in seen.update(State()))


def test_topics() -> None:
    """Topics have their types and ends; one that only waits for a type has none."""
    seen = picture()
    seen.update(State({"/chatter": ["/talker"]}, {"/chatter": ["/us"], "/odd": ["/us"]}, {}, TYPES))
    topics = seen.topics()
    assert topics["/chatter"].types == ("std_msgs/msg/String",)
    assert [(end.node, end.local) for end in topics["/chatter"].publishers] == [("/talker", False)]
    assert [(end.node, end.local) for end in topics["/chatter"].subscriptions] == [("/us", True)]
    assert topics["/odd"].types == ()


def test_actions() -> None:
    """Five topics that fit together are an action, and no topics."""
    seen = picture()
    events = seen.update(State(SERVER["publishers"], SERVER["subscribers"], {}, TYPES))
    assert [(event.name, event.type) for event in events if event.kind == "action"] == [("/move", "nav/action/Move")]
    assert not [event for event in events if event.kind in ("publisher", "subscription")]
    assert [server.node for server in seen.actions()["/move"].servers] == ["/mover"]
    assert not seen.topics()


def test_no_actions() -> None:
    """Topics whose types do not fit, or that no node serves, are topics."""
    for publishers, types in (
        (SERVER["publishers"], TYPES | {"/move/goal": "nav/msg/TurnActionGoal"}),
        (SERVER["publishers"], TYPES | {"/move/status": "std_msgs/msg/String"}),
        ({"/move/goal": ["/client"], "/move/cancel": ["/client"]}, TYPES),
    ):
        seen = picture()
        seen.update(State(publishers, SERVER["subscribers"], {}, types))
        assert not seen.actions()
        assert "/move/goal" in seen.topics()


def test_nodes() -> None:
    """Nodes have what they publish, read and serve."""
    seen = picture()
    state = State({"/chatter": ["/a"]}, {"/chatter": ["/b"]}, {"/add": ["/a"]}, TYPES, {"/add": "x/srv/Add"})
    seen.update(state)
    nodes = seen.nodes()
    assert nodes["/a"].publishers == (("/chatter", "std_msgs/msg/String"),)
    assert nodes["/a"].services == (("/add", "x/srv/Add"),)
    assert nodes["/b"].subscriptions == (("/chatter", "std_msgs/msg/String"),)
