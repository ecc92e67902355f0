"""Puts packets together that came in parts, which let small messages pass between them."""

from __future__ import annotations

from ropeway.networks.overlay.held_bytes import HeldBytes
from ropeway.networks.overlay.packet_mark import Mark

__all__ = ["PacketAssembly"]


class PacketAssembly:
    """The packet of one publisher that is coming in parts, in order: ``limit_bytes`` at most, out of a budget.

    A part that does not follow the one before ends the packet: it is lost, as any other may be. Not thread-safe.
    """

    def __init__(self, limit_bytes: int, held: HeldBytes) -> None:
        self._limit_bytes, self._held = limit_bytes, held
        self._size = 0
        self._came = bytearray()

    def take(self, mark: Mark, raw: bytes) -> bytes | None:
        """Return the packet that a part completes, ``None`` until then."""
        if not mark.at:
            self.drop()
            self._size = mark.size
        came = self._came
        fits = mark.at == len(came) and mark.size == self._size <= self._limit_bytes
        if not fits or mark.at + len(raw) > mark.size or not self._held.take(len(raw)):
            self.drop()
            return None
        came += raw
        if len(came) < mark.size:
            return None
        packet = bytes(came)
        self.drop()
        return packet

    def drop(self) -> None:
        """Give up what came."""
        self._held.give(len(self._came))
        self._came = bytearray()
        self._size = 0
