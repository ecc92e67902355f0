"""The types of one network beside ours."""

from __future__ import annotations

from pathlib import Path

import pytest

from ropeway.types import TypeRegistry
from ropeway.types.told_types import DefinitionTeller
from ropeway.types.variant import Variant, make_network

GOAL = "goal_msgs/action/Reach"
OLD = "float32 far\n---\nbool reached\n---\nfloat32 left\n"
NEW = "float32 far\nfloat32 speed 0.5\n---\nuint16 error_code\nbool reached\n---\nfloat32 left\n"


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A workspace with an older version of an action, and a type that is known there alone."""
    for name, text in (("action/Reach.action", OLD), ("msg/Alone.msg", "int32 n\n")):
        file = tmp_path / "goal_msgs" / name
        file.parent.mkdir(parents=True)
        file.write_text(text)
    return tmp_path


def test_definitions_of_a_network_count_there_alone(files: Path) -> None:
    """Two versions of one action stand side by side, and what the network alone defines is known everywhere."""
    ours = TypeRegistry()
    ours.add_text(GOAL, NEW)
    theirs = Variant(ours, paths=[files], label="dds:1")
    assert theirs.text(GOAL) == OLD
    assert ours.text(GOAL) == NEW
    assert theirs.hash(GOAL) != ours.hash(GOAL)
    assert theirs.differs(f"{GOAL}_SendGoal_Request")
    assert theirs.differs(GOAL)
    assert not theirs.differs(f"{GOAL}_Feedback")
    assert theirs.codec(f"{GOAL}_Feedback") is ours.codec(f"{GOAL}_Feedback")
    assert ours.has("goal_msgs/msg/Alone")
    assert GOAL in theirs.names("action")


def test_versions_are_translated_by_name(files: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Fields of both versions are carried over; others get their default or are left out, and each is told once."""
    ours = TypeRegistry()
    ours.add_text(GOAL, NEW)
    theirs = Variant(ours, paths=[files], label="dds:1")
    inward, outward = theirs.inward(f"{GOAL}_Goal"), theirs.outward(f"{GOAL}_Result")
    assert inward is not None
    assert outward is not None
    for _ in range(2):
        got = inward(theirs.codec(f"{GOAL}_Goal").encode({"far": 2.0}))
        assert ours.codec(f"{GOAL}_Goal").decode(got) == {"far": 2.0, "speed": 0.5}
        raw = outward(ours.codec(f"{GOAL}_Result").encode({"reached": True, "error_code": 3}))
        assert theirs.codec(f"{GOAL}_Result").decode(raw) == {"reached": True}
    assert caplog.messages == [
        f"{GOAL}_Goal.speed is missing in dds:1, filled with 0.5",
        f"{GOAL}_Result.error_code is not known in dds:1 and left out",
    ]


def test_a_network_follows_our_definitions() -> None:
    """What is added to ours, told to either and forgotten again is known, and forgotten, on the network, too."""
    ours = TypeRegistry()
    theirs = Variant(ours, "humble")
    name = "my_msgs/msg/Scan"
    assert not theirs.has(name)
    assert not theirs.differs(name)
    teller = DefinitionTeller(theirs)
    teller.tell(name, "sensor_msgs/Range[] ranges\n")
    assert ours.has(name)
    assert theirs.differs(name)
    assert theirs.full_text(name).count("variance") == 0
    assert ours.full_text(name).count("variance") == 1
    teller.leave()
    assert not theirs.has(name)
    assert not ours.has(name)


def test_own_definitions_win_over_a_distribution() -> None:
    """A standard type that the user defines anew is the same on every network."""
    ours = TypeRegistry()
    ours.add_text("sensor_msgs/msg/Range", "float64 distance\n", replace=True)
    theirs = Variant(ours, "humble")
    assert not theirs.differs("sensor_msgs/msg/Range")
    assert theirs.text("sensor_msgs/msg/Range") == "float64 distance\n"


def test_networks_of_which_nothing_is_given() -> None:
    """Without a distribution and files a network has our types; a distribution that nobody knows is refused."""
    ours = TypeRegistry()
    assert make_network(ours, None, label="dds:0") is None
    assert make_network(ours, "humble", label="dds:0") is make_network(ours, "humble", label="dds:1")
    with pytest.raises(ValueError, match="not a ROS 2 distribution; known are foxy"):
        make_network(ours, "noetic", label="dds:0")
