"""Lockout: who tries tokens that are wrong is answered later and later, and then not at all for a while."""

from __future__ import annotations

import time
from collections import Counter, OrderedDict
from collections.abc import Callable
from typing import Final

from ropeway.limits import (
    ADDRESSES,
    FIRST_LOCKOUT_S,
    LONGEST_LOCKOUT_S,
    WRONG_TOKEN_DELAY_S,
    WRONG_TOKEN_S,
    WRONG_TOKENS,
)

__all__ = ["Lockout"]

_LONGEST_DELAY_S: Final = 1.0


class _Record:
    """The wrong tokens of one sender: a bucket that fills as time goes by."""

    __slots__ = ("at", "left", "locked_until", "lockout_s")

    def __init__(self, now: float) -> None:
        self.left, self.at = float(WRONG_TOKENS), now
        self.locked_until, self.lockout_s = now, FIRST_LOCKOUT_S


class Lockout:
    """Counts wrong tokens per sender (see ``network_of``), and locks out senders with too many.

    A right token takes nothing back: it may be the sender's own, with few rights. ``counts`` are of all senders.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.counts: Counter[str] = Counter()
        self._clock = clock
        self._records: OrderedDict[str, _Record] = OrderedDict()

    def locked_s(self, sender: str) -> float:
        """Return for how long tokens of this sender are refused unread; 0 where they are looked at."""
        record = self._records.get(sender)
        return 0.0 if record is None else max(record.locked_until - self._clock(), 0.0)

    def wrong(self, sender: str) -> float:
        """Count a wrong token; return by how much the answer should be delayed, in seconds."""
        now = self._clock()
        record = self._records.pop(sender, None) or _Record(now)
        self._records[sender] = record
        if len(self._records) > ADDRESSES:
            self._records.popitem(last=False)
        self.counts["wrong tokens"] += 1
        regained = (now - record.at) / WRONG_TOKEN_S
        record.left, record.at = min(record.left + regained, float(WRONG_TOKENS)), now
        if record.left >= WRONG_TOKENS:
            record.lockout_s = FIRST_LOCKOUT_S
        record.left -= 1.0
        if record.left < 1.0:
            self.counts["lockouts"] += 1
            record.locked_until = record.at = now + record.lockout_s
            record.lockout_s = min(2 * record.lockout_s, LONGEST_LOCKOUT_S)
            record.left = 1.0  # one try once the time is over
        return min((WRONG_TOKENS - record.left) * WRONG_TOKEN_DELAY_S, _LONGEST_DELAY_S)

    def status(self) -> dict[str, int]:
        """Return how many wrong tokens and lockouts there were, and how many are locked out now, as JSON."""
        now = self._clock()
        locked = sum(record.locked_until > now for record in self._records.values())
        return {**{what: self.counts[what] for what in ("wrong tokens", "lockouts")}, "locked out": locked}
