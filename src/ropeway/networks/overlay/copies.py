"""Decides which packets have a copy that goes by the bypass (see ``ropeway.networks.overlay.bypass``)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Final

from ropeway.limits import OVERLAY_COPY_BYTES

__all__ = ["Copies", "CopyBudget"]

_RECENT: Final = 16  # packets of a publisher that may be on their way when its first copy is sent
_RECENT_S: Final = 0.5
_WINDOW_S: Final = 1.0
_SHARE: Final = 1 / 8  # of the path's pace is spent on copies
_LEFT_OUT_S: Final = 30.0


class Copies:
    """The copies of one publisher's packets, which ``put(gateway, packet)`` sends; belongs to its lane's thread.

    The first of them goes together with what was sent just before and may still be on its way, so that none overtakes
    what has no copy.
    """

    def __init__(self, put: Callable[[bytes, bytes], None]) -> None:
        self._put = put
        self._recent: deque[tuple[float, bytes]] = deque(maxlen=_RECENT)
        self._going: dict[bytes, int] = {}  # gateway: the connection by which it gets copies

    def send(self, packet: bytes, gateways: Sequence[bytes], connection: int, now_s: float) -> None:
        """Send copies of a packet to these gateways by a connection of this number, 0 for none."""
        self._recent.append((now_s, packet))
        for gateway in gateways if connection else ():
            first = self._going.get(gateway) != connection
            packets = [raw for at_s, raw in self._recent if now_s - at_s < _RECENT_S] if first else [packet]
            for raw in packets:
                self._put(gateway, raw)
        self._going = dict.fromkeys(gateways, connection)


class CopyBudget:
    """Bounds what copies take of one path: the publishers that send most are left out for a while. Sans-I/O."""

    def __init__(self) -> None:
        self._began_s = float("-inf")
        self._spent: dict[bytes, int] = {}
        self._left_out: dict[bytes, float] = {}  # until when

    def takes(self, publisher: bytes, size_bytes: int, bytes_per_s: float, now_s: float) -> bool:
        """Return whether a packet of a publisher goes by the bypass, too."""
        if now_s - self._began_s >= _WINDOW_S:
            self._began_s = now_s
            self._spent.clear()
            self._left_out = {other: until_s for other, until_s in self._left_out.items() if until_s > now_s}
        if publisher in self._left_out or size_bytes > OVERLAY_COPY_BYTES:
            return False
        spent = self._spent
        spent[publisher] = spent.get(publisher, 0) + size_bytes
        if sum(spent.values()) > _SHARE * bytes_per_s * _WINDOW_S:
            most = max(spent, key=spent.__getitem__)
            spent.pop(most)
            self._left_out[most] = now_s + _LEFT_OUT_S
        return publisher not in self._left_out
