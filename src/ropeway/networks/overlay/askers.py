"""Tells who asked what is answered on a topic, so that an answer goes to that gateway and to no other. Sans-I/O.

An answer whose header has the stamp of a request belongs to that request. Without stamps requests are taken to be
answered in order.
"""

from __future__ import annotations

from collections import deque
from typing import Final

__all__ = ["Askers"]

_MOST: Final = 1024  # requests that are remembered


class Askers:
    """The requests whose answers come on one topic, and who made them."""

    def __init__(self) -> None:
        self._open: dict[int, tuple[bytes | None, bytes]] = {}  # number: stamp and gateway, the oldest first
        self._by_stamp: dict[bytes, deque[int]] = {}
        self._number = 0
        self._stamped = False  # an answer has had the stamp of a request: the others will, too

    def asked(self, gateway: bytes, stamp: bytes | None) -> None:
        """Note a request."""
        self._number += 1
        self._open[self._number] = stamp, gateway
        if stamp is not None:
            self._by_stamp.setdefault(stamp, deque()).append(self._number)
        if len(self._open) > _MOST:
            self._take(next(iter(self._open)))

    def answered(self, stamp: bytes | None) -> bytes | None:
        """Return who asked for an answer with this stamp, ``None`` if nobody did."""
        if stamp is not None and stamp in self._by_stamp:
            self._stamped = True
            return self._take(self._by_stamp[stamp][0])
        if not self._open or (self._stamped and stamp is not None):
            return None
        return self._take(next(iter(self._open)))

    def forget(self, gateway: bytes) -> None:
        """Forget what a gateway asked that has left."""
        for number in [number for number, (_, asker) in self._open.items() if asker == gateway]:
            self._take(number)

    def _take(self, number: int) -> bytes:
        stamp, gateway = self._open.pop(number)
        if stamp is not None:
            numbers = self._by_stamp[stamp]
            numbers.remove(number)
            if not numbers:
                del self._by_stamp[stamp]
        return gateway
