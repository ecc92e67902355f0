"""The ``auto`` encoding: raw CDR, or compressed where that brings more messages over the link, or brings them sooner.

A model decides: with the pace of the link and the ratio and speed of compression as measured for this topic, which
encoding brings a message over sooner? It is not trusted blindly. While messages are lost because the link (or the
processor, or the peer) cannot keep up, the other encoding gets a turn now and then, what really went through is
counted, and the model is overruled where it was clearly wrong.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, Protocol

__all__ = ["SMALLEST_PACKED_BYTES", "EncodingChooser", "Paced"]

SMALLEST_PACKED_BYTES: Final = 2048
"""A smaller message goes raw: its header outweighs what compression saves."""

RAW: Final = "cbor-raw"
PACKED: Final = "zstd"
_OTHER: Final = {RAW: PACKED, PACKED: RAW}

_SAMPLE_S: Final = 5.0  # how often a topic that goes raw is compressed once, to know its ratio
_GAIN: Final = 0.85  # compression must save 15 % of the time, or the processor has better things to do
_WORTH_S: Final = 0.001  # a message that takes less on the wire goes raw
_TURN_S: Final = 0.5  # an encoding's turn while messages are lost
_TURN_MESSAGES: Final = 8
_LOSING: Final = 0.1  # of what was offered: more loss than that, and what gets through decides
_BETTER: Final = 1.2  # what overrules the model
_FIRST_RETRY_S: Final = 4.0
_LAST_RETRY_S: Final = 60.0


class Paced(Protocol):
    """Anything with a pace: ``ropeway.delivery.pacing.pace.Pace``, or the slowest of several."""

    @property
    def bytes_per_s(self) -> float | None:
        """Return the pace, ``None`` where it is not known."""


class EncodingChooser:
    """Chooses for one topic on one link."""

    def __init__(self, pace: Paced, clock: Callable[[], float] = time.monotonic) -> None:
        self._pace = pace
        self._clock = clock
        self.encoding = RAW
        self.ratio: float | None = None
        self._seconds_per_byte = 0.0
        self._sampled = float("-inf")
        self._next = RAW
        self._turn_at = self._asked_at = float("-inf")
        self._sent = self._lost = 0
        self._rates: dict[str, float] = {}
        self._retry_at = float("-inf")
        self._retry_s = _FIRST_RETRY_S
        self._losing = False
        self._trial: str | None = None

    def choose(self, size_bytes: int, sent: int, lost: int) -> str:
        """Return the encoding for the next message; ``sent`` and ``lost`` count the messages of the topic so far."""
        if size_bytes < SMALLEST_PACKED_BYTES:
            return RAW
        now = self._clock()
        if now - self._asked_at > _TURN_S:
            self._begin_turn(now, sent, lost)  # what was idle in between says nothing
        self._asked_at = now
        before = self.encoding
        self._decide(size_bytes, now, sent, lost)
        if self.encoding != before:
            self._begin_turn(now, sent, lost)
        return self._next

    def _decide(self, size_bytes: int, now: float, sent: int, lost: int) -> None:
        if now - self._turn_at >= _TURN_S and sent + lost - self._sent - self._lost >= _TURN_MESSAGES:
            self._end_turn(now, sent, lost)
        wanted = self._by_model(size_bytes)
        if not self._losing:
            self.encoding = wanted
        elif self._trial is None:
            other = _OTHER[wanted]
            rates = self._rates
            overruled = other in rates and wanted in rates and rates[other] > _BETTER * rates[wanted]
            self.encoding = other if overruled else wanted
            known = self.encoding in rates
            if known and now >= self._retry_at and self._may_win(_OTHER[self.encoding], size_bytes):
                self.encoding = self._trial = _OTHER[self.encoding]
        self._next = self.encoding
        if self.encoding == RAW and self._wants_sample(size_bytes, now):
            self._next = PACKED

    def measured(self, size_bytes: int, packed_bytes: int, seconds: float) -> None:
        """Tell what compressing one message brought and cost."""
        ratio = size_bytes / max(packed_bytes, 1)
        cost = seconds / max(size_bytes, 1)
        if self.ratio is None:
            self.ratio, self._seconds_per_byte = ratio, cost
        else:
            self.ratio += 0.2 * (ratio - self.ratio)
            self._seconds_per_byte += 0.2 * (cost - self._seconds_per_byte)

    def _begin_turn(self, now: float, sent: int, lost: int) -> None:
        self._turn_at, self._sent, self._lost = now, sent, lost

    def _end_turn(self, now: float, sent: int, lost: int) -> None:
        went, fell = sent - self._sent, lost - self._lost
        seconds = now - self._turn_at
        self._begin_turn(now, sent, lost)
        was_losing, self._losing = self._losing, fell > _LOSING * (went + fell)
        if not self._losing:
            self._trial = None
            return
        if not was_losing:
            self._rates.clear()  # what an encoding reached in another situation says nothing
        self._rates[self.encoding] = went / seconds
        if self._trial is not None:
            won = went / seconds > _BETTER * self._rates.get(_OTHER[self._trial], 0.0)
            self._trial = None
            self._retry_s = _FIRST_RETRY_S if won else min(2 * self._retry_s, _LAST_RETRY_S)
            self._retry_at = now + self._retry_s

    def _may_win(self, encoding: str, size_bytes: int) -> bool:
        """Return whether going raw can bring more messages: not more than the link has room for, and none on a slow
        link.
        """
        pace = self._pace.bytes_per_s
        if encoding == PACKED or pace is None:
            return True
        if self.ratio is not None and 2 * self._seconds_per_byte < 1 / (self.ratio * pace):
            return False
        return pace / size_bytes > self._rates.get(PACKED, 0.0)

    def _wants_sample(self, size_bytes: int, now: float) -> bool:
        """Return whether to compress this message as a sample, so that ratio and cost of compression stay known while
        messages go raw.
        """
        pace = self._pace.bytes_per_s
        if pace is None or size_bytes / pace < _WORTH_S or now - self._sampled < _SAMPLE_S:
            return False
        self._sampled = now
        return True

    def _by_model(self, size_bytes: int) -> str:
        pace = self._pace.bytes_per_s
        if pace is None or self.ratio is None or size_bytes / pace < _WORTH_S:
            return RAW
        raw_s = size_bytes / pace
        packed_s = raw_s / self.ratio + 2 * size_bytes * self._seconds_per_byte  # unpacking costs about the same
        return PACKED if packed_s < _GAIN * raw_s else RAW
