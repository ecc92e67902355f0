"""Commands are guarded: a lease, limits, a lifespan, one driver at a time."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.delivery.command_guard import CommandGuard, CommandRefusal, UnknownField, field_names
from ropeway.errors import ValueMismatch
from ropeway.graph.base import Sample
from ropeway.types import TypeRegistry

REGISTRY = TypeRegistry()
TWIST = REGISTRY.codec("geometry_msgs/msg/Twist")


class Clock:
    """Time that the test moves."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s

    def ns(self) -> int:
        """Return the time of day in nanoseconds."""
        return int(self.now_s * 1e9)


def guard(clock: Clock, **options: Any) -> CommandGuard:
    """Make a guard of a Twist."""
    return CommandGuard(TWIST, clock=clock, now_ns=clock.ns, **options)


def twist(x: float = 0.0, z: float = 0.0, *, sent_ns: int = 0) -> Sample:
    """Make a command."""
    payload = TWIST.encode({"linear": {"x": x}, "angular": {"z": z}})
    return Sample(payload, TWIST.type, sent_ns, bytes(16), 1, sent_ns=sent_ns)


def test_a_lease_ends_once() -> None:
    """Each command renews the lease; when it is over, the safe message is due once, until somebody drives again."""
    clock = Clock()
    guarded = guard(clock, lease_s=0.5)
    assert guarded.due_s is None
    assert not guarded.expire()
    assert guarded.admit(twist(1.0), "cloud") is not None
    clock.now_s += 0.4
    assert guarded.admit(twist(1.0), "cloud") is not None
    clock.now_s += 0.4
    assert not guarded.expire()
    assert guarded.driver == "cloud"
    clock.now_s += 0.2
    assert guarded.expire()
    assert not guarded.expire()
    assert guarded.due_s is None
    assert guarded.driver == ""
    assert TWIST.decode(guarded.safe().payload)["linear"]["x"] == 0.0
    assert guarded.admit(twist(1.0), "cloud") is not None
    assert guarded.due_s == clock.now_s + 0.5
    assert guarded.status()["expiries"] == 1


def test_a_safe_message_of_ones_own() -> None:
    """The safe message may be another than zero, and one with a header is stamped."""
    clock = Clock()
    assert TWIST.decode(guard(clock, on_expiry={"linear": {"z": -0.2}}).safe().payload)["linear"]["z"] == -0.2
    stamped = REGISTRY.codec("geometry_msgs/msg/TwistStamped")
    safe = CommandGuard(stamped, clock=clock, now_ns=clock.ns).safe()
    assert stamped.decode(safe.payload)["header"]["stamp"]["sec"] == 100


def test_limits() -> None:
    """Numbers beyond their limit are cut to it, with their sign; a command within is passed on as it is."""
    guarded = guard(Clock(), most={"linear.x": 0.5, "angular.z": 1.0})
    admitted = guarded.admit(twist(-3.0, 0.2), "a")
    assert admitted is not None
    message = TWIST.decode(admitted.payload)
    assert (message["linear"]["x"], message["angular"]["z"]) == (-0.5, 0.2)
    within = twist(0.5, -1.0)
    assert guarded.admit(within, "a") is within
    assert guarded.clamped == 1


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number(value: float) -> None:
    """A limited field that is no finite number refuses the command."""
    guarded = guard(Clock(), most={"linear.x": 0.5}, lease_s=1.0)
    assert guarded.admit(twist(value), "a") is None
    assert guarded.refused == {CommandRefusal.NUMBER: 1}
    assert guarded.due_s is None


def test_arrays() -> None:
    """Each number of an array is limited."""
    joints = REGISTRY.codec("trajectory_msgs/msg/JointTrajectoryPoint")
    guarded = CommandGuard(joints, most={"velocities": 1.0})
    payload = joints.encode({"velocities": [0.5, -2.0, 3.0]})
    admitted = guarded.admit(Sample(payload, joints.type, 0, bytes(16), 1), "a")
    assert admitted is not None
    assert list(joints.decode(admitted.payload)["velocities"]) == [0.5, -1.0, 1.0]


def test_garbage() -> None:
    """What is not of the type is refused where its fields matter."""
    guarded = guard(Clock(), most={"linear.x": 0.5})
    assert guarded.admit(Sample(b"\0\1\0\0xx", TWIST.type, 0, bytes(16), 1), "a") is None
    assert guarded.refused == {CommandRefusal.DECODE: 1}


def test_old_commands() -> None:
    """A command that was longer on its way than it lives is refused, and renews no lease."""
    clock = Clock()
    guarded = guard(clock, lifespan_s=0.3, lease_s=1.0)
    assert guarded.admit(twist(sent_ns=clock.ns() - 200_000_000), "a") is not None
    clock.now_s += 0.5
    assert guarded.admit(twist(sent_ns=clock.ns() - 400_000_000), "a") is None
    assert guarded.refused == {CommandRefusal.LATE: 1}
    assert guarded.due_s == 101.0


def test_the_first_driver_keeps_the_lease() -> None:
    """With "first", others are refused until the driver's lease is over."""
    clock = Clock()
    guarded = guard(clock, lease_s=0.5, drivers="first")
    assert guarded.admit(twist(), "joystick") is not None
    assert guarded.admit(twist(), "planner") is None
    clock.now_s += 0.6
    assert guarded.admit(twist(), "planner") is not None
    assert guarded.admit(twist(), "joystick") is None
    assert guarded.refused == {CommandRefusal.DRIVER: 2}


def test_the_newest_driver_takes_over() -> None:
    """With "newest", who begins takes over; who was taken over from is refused, until it stops and begins anew."""
    clock = Clock()
    guarded = guard(clock, lease_s=0.5, drivers="newest")
    for _ in range(5):
        assert guarded.admit(twist(), "planner") is not None
        clock.now_s += 0.1
    assert guarded.admit(twist(), "joystick") is not None
    for _ in range(5):
        clock.now_s += 0.1
        assert guarded.admit(twist(), "planner") is None
        assert guarded.admit(twist(), "joystick") is not None
    clock.now_s += 0.1
    for _ in range(7):
        clock.now_s += 0.1
        assert guarded.admit(twist(), "joystick") is not None
    assert guarded.admit(twist(), "planner") is not None


def test_unknown_fields() -> None:
    """A limit or a safe value of a field that the type does not have is refused at once."""
    with pytest.raises(UnknownField) as caught:
        guard(Clock(), most={"linear.q": 1.0})
    assert "linear.x" in caught.value.valid
    with pytest.raises(ValueMismatch):
        guard(Clock(), on_expiry={"liner": {"x": 1.0}})


def test_fields_that_can_be_limited() -> None:
    """The numbers of a type are found by their dotted paths."""
    assert field_names(TWIST) == ["linear.x", "linear.y", "linear.z", "angular.x", "angular.y", "angular.z"]


@given(st.floats(), st.floats(0, 1e6))
def test_nothing_beyond_a_limit_passes(value: float, limit: float) -> None:
    """Whatever is commanded, what passes is within the limit."""
    admitted = guard(Clock(), most={"linear.x": limit}).admit(twist(value), "a")
    assert admitted is None or abs(TWIST.decode(admitted.payload)["linear"]["x"]) <= limit
