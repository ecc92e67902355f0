"""Recognises duplicates: a sample is identified by its origin and sequence number.

Gateways may form a ring, stand side by side on one network, or forward a topic in both directions. A sample that enters
a graph a second time is dropped. A network such as DDS carries no origin; a sample read from another gateway's
publisher there (``relayed``) keeps only its sequence number, the first publisher's time stamp in nanoseconds, which is
enough.
"""

from __future__ import annotations

from itertools import islice
from typing import Final

from ropeway.graph.base import Sample

__all__ = ["KEPT_SAMPLES", "Seen"]

KEPT_SAMPLES: Final = 4096
"""How many are remembered of a topic at least, and twice as many at most: 4 s of a 1 kHz sensor, far more than two
paths differ."""

_MISSING: Final = b"missing"


class Seen(dict[int, "bytes | None"]):
    """The samples of one topic that a graph has had: the origin by number, ``None`` for relayed ones.

    On the way of a message the table itself is used; ``trim`` keeps it small.
    """

    __slots__ = ()

    def add(self, sample: Sample) -> None:
        """Remember a sample."""
        self[sample.seq] = None if sample.relayed else sample.origin
        if len(self) > 2 * KEPT_SAMPLES:
            self.trim()

    def take_in(self, other: Seen) -> None:
        """Remember the samples of another, too."""
        self.update(other)
        if len(self) > 2 * KEPT_SAMPLES:
            self.trim()

    def trim(self, keep: int = KEPT_SAMPLES) -> None:
        """Forget all but the last samples."""
        for seq in list(islice(self, max(len(self) - keep, 0))):
            del self[seq]

    def has(self, sample: Sample) -> bool:
        """Return whether this sample is a duplicate."""
        known = self.get(sample.seq, _MISSING)
        # one stamp, two origins: two publishers in the same nanosecond, unless one of the two lost its origin
        return known is not _MISSING and (known is None or sample.relayed or known == sample.origin)
