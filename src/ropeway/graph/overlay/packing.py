"""Whether messages are compressed before they are sealed: as configured, or as the path turns out to be."""

from __future__ import annotations

from typing import Final

from ropeway.overlay.item import RAW, ZSTD, Item
from ropeway.wire import filters

__all__ = ["Packing"]

_SMALL_BYTES: Final = 512  # not worth a frame
_TELLING_BYTES: Final = 32 * 1024  # fewer vanish in queues, whatever the path
_SLOW_BPS: Final = 60e6  # bytes per second: below, compressing an image brings it sooner
_FAST_BPS: Final = 120e6
_WEIGHT: Final = 0.3


class Packing:
    """Of one publisher. ``encoding`` is the configured one: ``zstd``, ``zip`` and ``rawzip`` always compress, ``auto``
    where what was sent before took long; without loss, by the filters for images and point clouds.
    """

    def __init__(self, type: str, encoding: str) -> None:
        self.type = type
        self.auto = encoding == "auto"
        self.on = encoding in ("zstd", "zip", "rawzip")
        self.pace_bps: float | None = None

    @property
    def used(self) -> str:
        """What is done now."""
        return "zstd" if self.on else "cbor-raw"

    def pack(self, item: Item) -> Item:
        """The item as it is to be sent."""
        if not self.on or len(item.payload) < _SMALL_BYTES or item.encoding != RAW:
            return item
        packed = filters.encode(item.payload, self.type)
        return item._replace(encoding=ZSTD, payload=packed) if len(packed) < len(item.payload) else item

    def sent(self, size: int, took_s: float) -> None:
        """So many bytes were taken by the path in so long."""
        if size < _TELLING_BYTES:
            return
        pace = size / max(took_s, 1e-6)
        self.pace_bps = pace if self.pace_bps is None else (1 - _WEIGHT) * self.pace_bps + _WEIGHT * pace
        if self.auto:
            self.on = self.pace_bps < (_FAST_BPS if self.on else _SLOW_BPS)
