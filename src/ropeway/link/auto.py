"""The ``auto`` encoding: raw CDR, or compressed where that brings a message over the link sooner.

Sooner is decided by what was measured on this link for this topic: the pace of the link, the ratio and the speed
of compression. A link whose pace is unknown is faster than what it is given, so raw it is.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from ropeway.link.pace import Pace

__all__ = ["EncodingChooser"]

_MIN_BYTES: Final = 2048  # below, a header outweighs what compression saves
_TRIAL_S: Final = 5.0  # how often a topic that goes raw is compressed once, to know its ratio
_GAIN: Final = 0.85  # compression must save 15 % of the time, or the processor has better things to do
_WORTH_S: Final = 0.001  # a message that takes less on the wire goes raw


class EncodingChooser:
    """Chooses for one topic on one link."""

    def __init__(self, pace: Pace, clock: Callable[[], float] = time.monotonic) -> None:
        self._pace = pace
        self._clock = clock
        self.encoding = "cbor-raw"
        self.ratio: float | None = None
        self._seconds_per_byte = 0.0
        self._tried = float("-inf")

    def choose(self, size_bytes: int) -> str:
        """The encoding for the next message of ``size_bytes``."""
        pace = self._pace.bytes_per_s
        if pace is None or size_bytes < _MIN_BYTES or size_bytes / pace < _WORTH_S:
            self.encoding = "cbor-raw"
            return self.encoding
        now = self._clock()
        if self.ratio is None or (self.encoding == "cbor-raw" and now - self._tried > _TRIAL_S):
            self._tried = now
            return "zstd"
        raw_s = size_bytes / pace
        packed_s = raw_s / self.ratio + 2 * size_bytes * self._seconds_per_byte  # unpacking costs about the same
        self.encoding = "zstd" if packed_s < _GAIN * raw_s else "cbor-raw"
        return self.encoding

    def measured(self, size_bytes: int, packed_bytes: int, seconds: float) -> None:
        """Tell what compressing one message brought and cost."""
        ratio = size_bytes / max(packed_bytes, 1)
        cost = seconds / max(size_bytes, 1)
        if self.ratio is None:
            self.ratio, self._seconds_per_byte = ratio, cost
        else:
            self.ratio += 0.2 * (ratio - self.ratio)
            self._seconds_per_byte += 0.2 * (cost - self._seconds_per_byte)
