"""ropeway.networks.rosbridge.protocol.state_lease: a state that a machine is told, and holds for a while."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.errors import InvalidOperation
from ropeway.networks.rosbridge.protocol.state_lease import LEASE_S, HeldState, StateLease


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
