"""What an action is made of."""

from __future__ import annotations

import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import DecodeError, InvalidName, UnknownType
from ropeway.graph.actions import ActionParts, action_of_service, actions_of
from ropeway.graph.actions.parts import status_array, status_entry
from ropeway.graph.calls import GoalStatus, ProviderInfo, ServiceInfo, new_id
from tests.support.actions import FIBONACCI, order, sequence

from .conftest import REGISTRY

PARTS = ActionParts("/count", FIBONACCI, REGISTRY)
LOOKUP = ActionParts("/tf", "tf2_msgs/LookupTransform", REGISTRY)


def test_names() -> None:
    """The services and topics of an action have the names and types that ROS 2 gives them."""
    assert (PARTS.send_goal, PARTS.send_goal_type) == ("/count/_action/send_goal", f"{FIBONACCI}_SendGoal")
    assert (PARTS.get_result, PARTS.get_result_type) == ("/count/_action/get_result", f"{FIBONACCI}_GetResult")
    assert PARTS.cancel_goal == "/count/_action/cancel_goal"
    assert (PARTS.feedback, PARTS.feedback_type) == ("/count/_action/feedback", f"{FIBONACCI}_FeedbackMessage")
    assert PARTS.status == "/count/_action/status"


def test_short_type() -> None:
    """A type may be written without its middle part."""
    assert LOOKUP.type == "tf2_msgs/action/LookupTransform"


def test_unknown_type() -> None:
    """An action of an unknown type is refused with its name and the nearest that is known."""
    with pytest.raises(UnknownType, match="nobody/action/Knows is not known"):
        ActionParts("/count", "nobody/action/Knows", REGISTRY)
    with pytest.raises(UnknownType, match="did you mean example_interfaces/action/Fibonacci"):
        ActionParts("/count", "example_interfaces/action/Fibonaci", REGISTRY)


def test_bad_name() -> None:
    """A name that ROS does not allow is refused."""
    with pytest.raises(InvalidName):
        ActionParts("/count//x", FIBONACCI, REGISTRY)


def test_goal_is_set_in() -> None:
    """A goal around which the id is set is the message that the codec makes, and comes out again."""
    id = new_id()
    codec = REGISTRY.codec(f"{FIBONACCI}_SendGoal_Request")
    joined = PARTS.join(id, order(7))
    assert joined == codec.encode({"goal_id": {"uuid": id}, "goal": {"order": 7}})
    assert PARTS.split(joined) == (id, order(7))


def test_alignment_is_kept() -> None:
    """A goal with fields of all alignments is the same bytes inside its message."""
    goal = {
        "target_frame": "map",
        "source_frame": "a",
        "source_time": {"sec": 1, "nanosec": 2},
        "timeout": {"sec": 3, "nanosec": 4},
        "fixed_frame": "odd",
        "advanced": True,
    }
    id = new_id()
    alone = REGISTRY.codec("tf2_msgs/action/LookupTransform_Goal").encode(goal)
    whole = REGISTRY.codec("tf2_msgs/action/LookupTransform_SendGoal_Request").encode(
        {"goal_id": {"uuid": id}, "goal": goal}
    )
    assert LOOKUP.join(id, alone) == whole
    assert LOOKUP.split(whole) == (id, alone)


def test_big_endian_goal() -> None:
    """A goal of the other byte order stays one."""
    id = new_id()
    goal = b"\0\0\0\0" + struct.pack(">i", 7)
    joined = PARTS.join(id, goal)
    codec = REGISTRY.codec(f"{FIBONACCI}_SendGoal_Request")
    assert codec.decode(joined)["goal"]["order"] == 7
    assert PARTS.split(joined) == (id, goal)


@given(st.binary(max_size=64))
def test_any_bytes(message: bytes) -> None:
    """Bytes of any kind are either a message with a goal id or a ``DecodeError``."""
    for read in (PARTS.split, PARTS.is_accepted, PARTS.outcome, PARTS.cancel_wish, PARTS.cancel_answer):
        with contextlib.suppress(DecodeError):
            read(message)


def test_result() -> None:
    """A result and its status come out of the message that they go into."""
    assert PARTS.outcome(PARTS.result(GoalStatus.CANCELED, sequence(1, 2))) == (5, sequence(1, 2))


def test_no_result() -> None:
    """A goal without a result has the default values."""
    assert PARTS.outcome(PARTS.result(GoalStatus.ABORTED, None)) == (6, sequence())


def test_cancel_messages() -> None:
    """A cancellation and its answer come out of the messages that they go into."""
    id = new_id()
    assert PARTS.cancel_wish(PARTS.cancel_request(id, 5_000_000_007)) == (id, 5_000_000_007)
    assert PARTS.cancel_answer(PARTS.cancelling(2, [(id, 1)])) == (2, [id])


@pytest.mark.parametrize("count", [0, 1, 2, 300])
def test_statuses(count: int) -> None:
    """The array of statuses is the one of action_msgs, byte for byte, however many there are."""
    codec = REGISTRY.codec("action_msgs/msg/GoalStatusArray")
    goals = [(new_id(), 1_000_000_002 + 10**9 * i, GoalStatus(i % 7)) for i in range(count)]
    array = status_array([status_entry(*goal) for goal in goals])
    listed = codec.decode(array)["status_list"]
    found = [(bytes(info["goal_id"]["uuid"]), info["stamp"]) for info in (entry["goal_info"] for entry in listed)]
    assert found == [(id, {"sec": ns // 10**9, "nanosec": 2}) for id, ns, _ in goals]
    assert [entry["status"] for entry in listed] == [status for _, _, status in goals]
    assert codec.encode({"status_list": listed}) == array


def test_accepted() -> None:
    """The answer to a goal is the one of the action's own type, byte for byte."""
    codec = REGISTRY.codec("example_interfaces/action/Fibonacci_SendGoal_Response")
    expected = codec.encode({"accepted": True, "stamp": {"sec": 5, "nanosec": 7}})
    assert PARTS.accepted(True, 5_000_000_007) == expected


def test_action_of_service() -> None:
    """The service that takes goals tells its action, others tell none."""
    assert action_of_service("/a/b/_action/send_goal", "p/action/X_SendGoal") == ("/a/b", "p/action/X")
    assert action_of_service("/a/_action/get_result", "p/action/X_GetResult") is None
    assert action_of_service("/_action/send_goal") is None
    assert action_of_service("/a/send_goal") is None


def test_actions_of() -> None:
    """Actions are told from the services, with who serves and uses them."""
    server, user = ProviderInfo("/far"), ProviderInfo("/near")
    services = {
        name: ServiceInfo(name, (f"{FIBONACCI}_SendGoal",), (server,), (user,))
        for name in ("/count/_action/send_goal", "/add")
    }
    found = actions_of(services)
    assert list(found) == ["/count"]
    assert (found["/count"].type, found["/count"].servers, found["/count"].clients) == (FIBONACCI, (server,), (user,))
