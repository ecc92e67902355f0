"""Decides whether messages are compressed before they are sealed: as configured, or as the path turns out to be."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Final

from ropeway.delivery.codec_times import ENCODING
from ropeway.delivery.compression import filters
from ropeway.delivery.encoding_choice import EncodingChooser
from ropeway.delivery.outbox import Lost
from ropeway.delivery.pacing.pace import Pace
from ropeway.networks.overlay.packet_item import RAW, ZSTD, PacketItem

__all__ = ["TopicPacking"]

_SMALL_BYTES: Final = 512  # not worth a frame
_TELLING_BYTES: Final = 32 * 1024  # fewer vanish in queues, whatever the path
_ALWAYS: Final = ("zstd", "zip", "rawzip")


class TopicPacking:
    """Compresses the messages of one publisher. ``encoding`` is the configured one: ``zstd``, ``zip`` and ``rawzip``
    always compress, ``auto`` where that brings messages over sooner; without loss, by the filters for images and
    point clouds.

    ``slowest`` gives the pace of the slowest path that acknowledges, ``None`` where none does: then it is judged by how
    long what was sent took to be taken.
    """

    def __init__(self, type: str, encoding: str, slowest: Callable[[], float | None] = lambda: None) -> None:
        self.type = type
        self.on = encoding in _ALWAYS
        self._slowest = slowest
        self._taken = Pace()
        self._chooser = EncodingChooser(self) if encoding == "auto" else None
        self._sent = 0
        if self.on or self._chooser is not None:
            filters.prepare(type)

    @property
    def bytes_per_s(self) -> float | None:
        """The pace of the path, ``None`` where it is not known."""
        pace = self._slowest()
        return self._taken.bytes_per_s if pace is None else pace

    @property
    def used(self) -> str:
        """The encoding in use now."""
        return "zstd" if self.on else "cbor-raw"

    def choose(self, size_bytes: int, lost: Mapping[Lost, int]) -> bool:
        """Return whether to compress the next message; ``lost`` counts those that could not be sent."""
        self._sent += 1
        if self._chooser is not None:
            fell = lost[Lost.REPLACED] + lost[Lost.OVERFLOW]
            self.on = self._chooser.choose(size_bytes, self._sent, fell) == "zstd"
        return self.on

    def pack(self, item: PacketItem, on: bool) -> PacketItem:
        """Return the item as it is to be sent."""
        if not on or len(item.payload) < _SMALL_BYTES or item.encoding != RAW:
            return item
        began = time.perf_counter()
        packed = ENCODING.timed("zstd", lambda: filters.encode(item.payload, self.type))
        if self._chooser is not None:
            self._chooser.measured(len(item.payload), len(packed), time.perf_counter() - began)
        return item._replace(encoding=ZSTD, payload=packed) if len(packed) < len(item.payload) else item

    def taken(self, size_bytes: int, seconds: float) -> None:
        """Note how long Zenoh took to accept so many bytes."""
        if size_bytes >= _TELLING_BYTES:
            self._taken.carried(size_bytes, seconds)
