"""Determines who published a message, from what the middleware tells with it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from ropeway.networks.ros2.discovery import Ros2Discovery

__all__ = ["Origins"]

# These tell with a message a number of this process instead of the publisher's gid, as discovery shows it.
_NUMBERS: Final = ("rmw_cyclonedds_cpp",)
_LIMIT: Final = 4096


class Origins:
    """Finds origins, and who is not to be heard: ourselves, and other processes of the same gateway."""

    def __init__(self, rmw: str, discovery: Ros2Discovery) -> None:
        self._numbers = rmw in _NUMBERS
        self._discovery = discovery
        self._mine: dict[bytes, None] = {}
        self._found: dict[bytes, bytes] = {}
        self._taken: dict[bytes, bytes] = {}

    def add_own(self, gid: bytes) -> None:
        """Register a publisher of ours; it is remembered for some time after closing, since its messages may be in
        flight.
        """
        self._mine[gid] = None
        if len(self._mine) > _LIMIT:
            del self._mine[next(iter(self._mine))]

    def of(self, topic: str, type: str, gid: bytes, matched: Callable[[], int]) -> tuple[bytes, bool] | None:
        """Return the origin of a message, and whether it is only known here; ``None`` for a message that must not be
        delivered.

        ``matched`` counts the publishers that the reader of the message is matched with.
        """
        if gid in self._mine:
            return None
        if not self._numbers:
            return None if gid in self._discovery.own_gids else (gid, False)
        origin = self._found.get(gid)
        if origin is None:
            origin = self._find(topic, type, gid, matched)
            if origin is None:
                return gid, True
        return None if origin in self._discovery.own_gids else (origin, False)

    def _find(self, topic: str, type: str, number: bytes, matched: Callable[[], int]) -> bytes | None:
        """Return the one publisher that this number can stand for."""
        publishers = self._discovery.all_publishers(topic, type)
        free = [e.gid for e in publishers if not e.local and self._taken.get(e.gid) is None]
        if len(free) != 1 or matched() != len(publishers):
            return None
        if len(self._found) >= _LIMIT:
            self._found.clear()
            self._taken.clear()
        self._found[number] = free[0]
        self._taken[free[0]] = number
        return free[0]
