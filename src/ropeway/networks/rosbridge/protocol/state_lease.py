"""The state that a robot's gateway gives a machine of its group for a while: ``state`` of the ``ropeway.1`` dialect."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from ropeway.errors import InvalidOperation
from ropeway.limits import STATE_CHARACTERS, STATE_LEASE_S

__all__ = ["LEASE_S", "HeldState", "StateLease"]

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
