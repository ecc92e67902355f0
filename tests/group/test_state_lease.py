"""ropeway.group.state_lease: a state that a machine is told, and holds for a while."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.errors import InvalidOperation
from ropeway.group.state_lease import LEASE_S, HeldState, HeldStates, StateLease
from ropeway.limits import HELD_STATES


def test_held_by_lease() -> None:
    """A machine holds what it was told until the lease is over, and each renewal begins it anew."""
    now = 10.0
    held = HeldState(lambda: now)
    assert held.status() == {}
    held.told(StateLease.message("edges", "service"), "robot")
    now += 0.9 * LEASE_S
    held.told(StateLease.message("edges", "service"), "robot")
    now += 0.9 * LEASE_S
    assert held.status() == {"state": {"group": "edges", "state": "service"}}
    now += LEASE_S
    assert held.lease is None and held.status() == {}


@pytest.mark.parametrize(
    "changes",
    [
        {"state": 5},
        {"state": ""},
        {"state": "x" * 257},
        {"group": None},
        {"lease_s": True},
        {"lease_s": 0},
        {"lease_s": 1e9},
        {"lease_s": float("nan")},
        {"lease_s": "3"},
    ],
)
def test_garbage(changes: dict[str, Any]) -> None:
    """What is no state is refused, and the one that is held stays."""
    held = HeldState(lambda: 0.0)
    held.told(StateLease.message("edges", "standby"), "robot")
    with pytest.raises(InvalidOperation):
        held.told(StateLease.message("edges", "service") | changes, "robot")
    assert held.status()["state"]["state"] == "standby"


def test_states_of_several_robots() -> None:
    """The state of each robot's group is held on its own, a bounded number of them, and the oldest is forgotten."""
    now = 10.0
    held = HeldStates(lambda: now)
    held.told(StateLease.message("edges", "service"), "robot1")
    held.told(StateLease.message("edges", "standby"), "robot2")
    assert [(row["robot"], row["state"]) for row in held.status()] == [("robot1", "service"), ("robot2", "standby")]
    for number in range(HELD_STATES):
        held.told(StateLease.message(f"g{number}", "standby"), "robot3")
    assert len(held.status()) == HELD_STATES
    assert {row["robot"] for row in held.status()} == {"robot3"}
    now += LEASE_S
    assert held.status() == []
