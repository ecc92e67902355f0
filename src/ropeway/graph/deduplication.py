"""Recognises duplicates: a sample is identified by its origin and sequence number.

Gateways may form a ring, stand side by side on one network, or forward a topic in both directions. A sample that enters
a graph a second time is dropped. A network such as DDS carries no origin; a sample read from another gateway's
publisher there (``relayed``) keeps only its sequence number, the first publisher's time stamp in nanoseconds, which is
enough.
"""

from __future__ import annotations

from typing import Final

from ropeway.graph.base import Sample

__all__ = ["Seen"]

_KEEP: Final = 4096  # per topic: 4 s of a 1 kHz sensor, far more than two paths differ


class Seen:
    """The samples of one topic that a graph has had."""

    __slots__ = ("_newer", "_older")

    def __init__(self) -> None:
        self._newer: dict[int, bytes | None] = {}
        self._older: dict[int, bytes | None] = {}

    def add(self, sample: Sample) -> None:
        """Remember a sample."""
        if len(self._newer) >= _KEEP:
            self._older, self._newer = self._newer, {}
        self._newer[sample.seq] = None if sample.relayed else sample.origin

    def update(self, other: Seen) -> None:
        """Remember the samples of another, too."""
        for known in (other._older, other._newer):
            if len(self._newer) + len(known) > _KEEP:
                self._older, self._newer = self._newer, {}
            self._newer.update(known)

    def has(self, sample: Sample) -> bool:
        """Return whether this sample is a duplicate."""
        seq = sample.seq
        known = self._newer.get(seq, _MISSING)
        if known is _MISSING:
            known = self._older.get(seq, _MISSING)
            if known is _MISSING:
                return False
        # one stamp, two origins: two publishers in the same nanosecond, unless one of the two lost its origin
        return known is None or sample.relayed or known == sample.origin


_MISSING: Final = b"missing"
