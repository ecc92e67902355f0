"""Measures how fast a link carries bytes, from what arrives at the far end.

Bytes that are sent back to back arrive at the pace of the narrowest place on the way, so a row of acknowledgements
shows it, also where the row is short and the link is idle in between. While there was always more to send, a row is a
measurement; otherwise it is a lower bound, which counts only where it is above what was thought.
"""

from __future__ import annotations

from typing import Final

__all__ = ["Pace"]

_LEAST_ROW_S: Final = 0.001
_SHORTEST_ROW_S: Final = 0.005  # a row that goes on may be measured so often
_LONGEST_ROW_S: Final = 0.05
_ROW_SEGMENTS: Final = 8  # fewer say more of how acknowledgements are bundled than of the link
_LEAST_ROW_BYTES: Final = 8 * 1024
_UP: Final = 0.5  # of the difference, per row
_DOWN: Final = 0.25
_PAUSE_S: Final = 0.003  # without an acknowledgement, and so many segments' time: the row is over
_PAUSE_SEGMENTS: Final = 6
_LONGEST_PAUSE_S: Final = 0.1


class Pace:
    """The pace of one connection. ``bytes_per_s`` is ``None`` until enough was sent to see it.

    A measurement that is faster than was thought counts for the share ``up``, one that is slower for ``down``.
    """

    def __init__(self, *, up: float = _UP, down: float = _DOWN) -> None:
        self._up, self._down = up, down
        self.bytes_per_s: float | None = None
        self._from: tuple[float, int] | None = None  # where the row began: time and bytes delivered
        self._last_s = 0.0  # when bytes arrived last, as far as we looked
        self._last_bytes = 0
        self._busy = True

    def observe(
        self, now_s: float, delivered_bytes: int, *, in_flight_bytes: int, busy: bool, segment_bytes: int
    ) -> None:
        """Take a reading; ``busy`` tells whether there was more to send than was let out."""
        if delivered_bytes == self._last_bytes:
            self._busy = self._busy and busy  # a pause of a busy link is its own
            if self._from is not None and not self._busy and now_s - self._last_s > self._pause_s(segment_bytes):
                self._end_row(segment_bytes)
            return
        if self._from is None or not in_flight_bytes:
            if self._from is not None:  # the last bytes came at an unknown moment
                self._end_row(segment_bytes)
            if in_flight_bytes:
                self._from = (now_s, delivered_bytes)
                self._busy = busy
            self._last_s, self._last_bytes = now_s, delivered_bytes
            return
        self._last_s, self._last_bytes = now_s, delivered_bytes
        self._busy = self._busy and busy
        seconds, size = now_s - self._from[0], delivered_bytes - self._from[1]
        least = self._least_bytes(segment_bytes)
        if size >= least and (seconds >= _LONGEST_ROW_S or (seconds >= _SHORTEST_ROW_S and size >= 4 * least)):
            self._end_row(segment_bytes)
            self._from = (now_s, delivered_bytes)
            self._busy = busy

    def carried(self, size_bytes: int, seconds: float, *, busy: bool = True) -> None:
        """Take a measurement: so many bytes arrived in so many seconds."""
        rate = size_bytes / max(seconds, 1e-6)
        before = self.bytes_per_s
        if before is None:
            self.bytes_per_s = rate
        elif rate > before:
            self.bytes_per_s = before + self._up * (rate - before)
        elif busy:
            self.bytes_per_s = before + self._down * (rate - before)

    @staticmethod
    def _least_bytes(segment_bytes: int) -> int:
        return max(_ROW_SEGMENTS * segment_bytes, _LEAST_ROW_BYTES)

    def _pause_s(self, segment_bytes: int) -> float:
        if self.bytes_per_s is None:
            return _LONGEST_PAUSE_S
        return max(_PAUSE_S, _PAUSE_SEGMENTS * segment_bytes / self.bytes_per_s)

    def _end_row(self, segment_bytes: int) -> None:
        begin, self._from = self._from, None
        if begin is None:
            return
        size, seconds = self._last_bytes - begin[1], self._last_s - begin[0]
        if seconds >= _LEAST_ROW_S and size >= self._least_bytes(segment_bytes):
            self.carried(size, seconds, busy=self._busy)
