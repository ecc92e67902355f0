"""A budget for what waits in one gateway, of all publishers together."""

from __future__ import annotations

import threading

from ropeway.limits import OVERLAY_HELD_BYTES

__all__ = ["HeldBytes"]


class HeldBytes:
    """Counts bytes that are held; the owner of some gives them back when it lets them go. Thread-safe."""

    __slots__ = ("_lock", "bytes", "limit_bytes")

    def __init__(self, limit_bytes: int = OVERLAY_HELD_BYTES) -> None:
        self.limit_bytes = limit_bytes
        self.bytes = 0
        self._lock = threading.Lock()

    def take(self, size: int) -> bool:
        """Hold ``size`` bytes more; return false, and hold nothing, where there is no room."""
        with self._lock:
            if self.bytes + size > self.limit_bytes:
                return False
            self.bytes += size
            return True

    def give(self, size: int) -> None:
        """Hold ``size`` bytes less."""
        with self._lock:
            self.bytes -= size
