"""The messages of actionlib."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ropeway.errors import DecodeError
from ropeway.graph.calls import GoalStatus, new_id
from ropeway.networks.ros1 import action_wire as wire
from ropeway.types import TypeRegistry
from ropeway.types.ros1_types import Ros1Types

TEXTS = st.text(st.characters(codec="utf-8"), max_size=20)
STATUSES = st.builds(
    wire.Ros1GoalStatus,
    st.builds(wire.GoalId, TEXTS, st.integers(0, 2**32 * 10**9 - 1)),
    st.sampled_from(wire.Code),
    TEXTS,
)


@settings(deadline=None)
@given(STATUSES, st.binary(max_size=20))
def test_round_trip(status: wire.Ros1GoalStatus, body: bytes) -> None:
    """Goals, requests to cancel, reports and lists are read as they were written."""
    assert wire.read_goal(wire.goal_message(status.goal, body)) == (status.goal, body)
    assert wire.read_report(wire.report_message(status, body)) == (status, body)
    assert wire.read_statuses(wire.statuses_message([status, status])) == [status, status]
    assert wire.read_cancel(wire.cancel_message(status.goal.text)) == wire.GoalId(status.goal.text)


@settings(deadline=None)
@given(st.binary(max_size=60))
def test_any_bytes(raw: bytes) -> None:
    """Bytes that are no such message are a ``DecodeError``."""
    for read in (wire.read_goal, wire.read_report, wire.read_statuses, wire.read_cancel):
        try:
            read(raw)
        except DecodeError as error:
            assert error.encoding == "ROS 1"


def test_is_what_the_codec_reads() -> None:
    """The codec of the message type reads what is written here."""
    types = Ros1Types(TypeRegistry())
    status = wire.Ros1GoalStatus(wire.GoalId("one", 5_000_000_006), wire.Code.SUCCEEDED, "done")
    converter = types.converter("actionlib_msgs/msg/GoalStatusArray")
    got = types.registry.codec("actionlib_msgs/msg/GoalStatusArray").decode(
        converter.from_ros1(wire.statuses_message([status]))
    )
    (listed,) = got["status_list"]
    assert listed["goal_id"] == {"stamp": {"sec": 5, "nanosec": 6}, "id": "one"}
    assert (listed["status"], listed["text"]) == (3, "done")


def test_ids() -> None:
    """An id of ours survives the way through ROS 1; any other text has always the same id."""
    id = new_id()
    assert wire.goal_bytes(wire.goal_text(id)) == id
    assert wire.goal_bytes("/client-1-12.5") == wire.goal_bytes("/client-1-12.5")
    assert len(wire.goal_bytes("")) == 16


@pytest.mark.parametrize(
    ("code", "status"),
    [
        (wire.Code.SUCCEEDED, GoalStatus.SUCCEEDED),
        (wire.Code.PREEMPTED, GoalStatus.CANCELED),
        (wire.Code.RECALLED, GoalStatus.CANCELED),
        (wire.Code.ABORTED, GoalStatus.ABORTED),
        (wire.Code.REJECTED, GoalStatus.ABORTED),
        (wire.Code.LOST, GoalStatus.ABORTED),
    ],
)
def test_codes(code: wire.Code, status: GoalStatus) -> None:
    """Ends of goals are those of ROS 2."""
    assert code.final
    assert code.outcome is status
