"""The state that a robot's gateway gives a machine of its group for a while.

It is the operation ``state`` of the ``ropeway.1`` dialect on a link, and a request in the overlay.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from ropeway.errors import InvalidOperation
from ropeway.limits import HELD_STATES, STATE_CHARACTERS, STATE_LEASE_S

__all__ = ["LEASE_S", "HeldState", "HeldStates", "StateLease"]

log = logging.getLogger("ropeway.group")

LEASE_S: Final = 3.0
"""How long a machine holds a state that nobody renews: a robot that is gone is noticed no sooner."""


@dataclass(frozen=True, slots=True)
class StateLease:
    """The state of a machine in one robot's group, until ``until_s`` of the machine's own steady clock."""

    group: str
    state: str
    until_s: float

    @classmethod
    def read(cls, message: Mapping[str, Any], now_s: float) -> StateLease:
        """Read what a gateway sent. Raises ``InvalidOperation``."""
        group, state, lease_s = message.get("group"), message.get("state"), message.get("lease_s")
        for key, text in (("group", group), ("state", state)):
            if not isinstance(text, str) or not 0 < len(text) <= STATE_CHARACTERS:
                raise InvalidOperation("state", f"{key} is no text of up to {STATE_CHARACTERS} characters")
        if isinstance(lease_s, bool) or not isinstance(lease_s, int | float) or not 0 < lease_s <= STATE_LEASE_S:
            raise InvalidOperation("state", f"lease_s is no number of seconds up to {STATE_LEASE_S:g}")
        return cls(str(group), str(state), now_s + lease_s)

    @staticmethod
    def message(group: str, state: str) -> dict[str, Any]:
        """Return the operation that gives a state for ``LEASE_S``."""
        return {"op": "state", "group": group[:STATE_CHARACTERS], "state": state, "lease_s": LEASE_S}


class HeldState:
    """Holds the state that one robot's gateway has given this machine, until its lease is over."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lease: StateLease | None = None

    def told(self, message: Mapping[str, Any], by: str) -> None:
        """Take a state. Raises ``InvalidOperation``."""
        before, lease = self.lease, StateLease.read(message, self._clock())
        if before is None or (before.group, before.state) != (lease.group, lease.state):
            log.info("%s: state %s in the group %s", by, lease.state, lease.group)
        self._lease = lease

    @property
    def lease(self) -> StateLease | None:
        """The lease, ``None`` once it is over."""
        held = self._lease
        return held if held is not None and held.until_s > self._clock() else None

    def status(self) -> dict[str, Any]:
        """Return the state as JSON, empty where none is held."""
        lease = self.lease
        return {} if lease is None else {"state": {"group": lease.group, "state": lease.state}}


class HeldStates:
    """Holds the states that several robots' gateways have given this machine, up to a number; the oldest goes first."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._held: dict[tuple[str, str], HeldState] = {}

    def told(self, message: Mapping[str, Any], by: str) -> None:
        """Take a state. Raises ``InvalidOperation``."""
        key = by, StateLease.read(message, self._clock()).group
        held = self._held.pop(key, None) or HeldState(self._clock)
        held.told(message, by)
        self._held[key] = held  # as the newest
        while len(self._held) > HELD_STATES:
            del self._held[next(iter(self._held))]

    def status(self) -> list[dict[str, str]]:
        """Return whose states are held, and which, as JSON; those whose leases are over are forgotten."""
        self._held = {key: held for key, held in self._held.items() if held.lease is not None}
        return [
            {"robot": by, "group": group, "state": lease.state}
            for (by, group), held in self._held.items()
            if (lease := held.lease) is not None
        ]
