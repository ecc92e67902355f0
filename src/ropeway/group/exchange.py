"""Requests on one topic and responses on another, as a service without the name: who is asked, and which answer counts.

Sans-I/O. Each request is answered once, by whoever is first; an answer to a request that is older than one already
answered comes too late to be of use. What a machine says unasked counts from the one in use; but where answers carry
the stamps of their requests, one that carries none of ours is for another robot of the same pool.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Final

from ropeway.graph.base import Undelivered
from ropeway.group.pairing import How, Pairing
from ropeway.group.scheduler import Scheduler

__all__ = ["Exchange"]

_MOST: Final = 1024  # requests whose order is remembered


class Exchange:
    """A pair of topics, requested from the members that ``scheduler`` chooses."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler
        self._pairings: dict[str, Pairing] = {}
        self._order: dict[Hashable, int] = {}
        self._asked = 0
        self._answered_up_to = 0  # the number of the newest request that has its answer
        self._answered: set[Hashable] = set()
        self._speaker = ""  # whose unasked messages count
        self._readers: set[object] = set()
        self.read = False
        """Whether anybody reads the answers; else none will come, and requests without them tell nothing."""

    def read_by(self, reader: object) -> None:
        """Note who reads the answers."""
        self._readers.add(reader)
        self.read = True

    def unread_by(self, reader: object) -> None:
        """Note that somebody reads them no longer; after the last one no request under way is late."""
        self._readers.discard(reader)
        self.read = bool(self._readers)
        if self.read:
            return
        for name, pairing in self._pairings.items():
            for key in pairing.unheard():
                self._scheduler.refused(name, key)
        self._scheduler.unheard()

    def asked(self, names: Sequence[str], key: Hashable, stamp: Hashable | None, now_s: float) -> None:
        """Note that a request was sent to ``names``; where nobody reads the answers, it says nothing of them."""
        if not self.read and stamp is None:
            return  # which answer is its own could not be told later
        if key not in self._order:
            self._asked += 1
            self._order[key] = self._asked
            while len(self._order) > _MOST:
                oldest = next(iter(self._order))
                del self._order[oldest]
                self._answered.discard(oldest)
        for name in names:
            pairing = self._pairings.get(name)
            if pairing is None:
                pairing = self._pairings[name] = Pairing()
            pairing.asked(key, stamp)
        if self.read:
            self._scheduler.asked(names, key, now_s)

    def is_open(self, key: Hashable) -> bool:
        """Return whether a request still waits for its answer."""
        return key in self._order and key not in self._answered

    def came(self, name: str, stamp: Hashable | None, now_s: float) -> Undelivered | None:
        """Return why a message of ``name`` on the response topic is dropped, ``None`` to deliver it."""
        pairing = self._pairings.get(name)
        key = None if pairing is None else pairing.answered(stamp)
        if key is None:
            by_stamp = stamp is not None and any(other.stamped for other in self._pairings.values())
            return Undelivered.FOREIGN if by_stamp else self.unasked(name)
        self._scheduler.answered(name, key, now_s)
        number = self._order.get(key, 0)
        if key in self._answered or not number:
            return Undelivered.ANSWERED
        self._answered.add(key)
        if number < self._answered_up_to:
            return Undelivered.OUTDATED
        self._answered_up_to = number
        if name == self._scheduler.current:
            self._speaker = name
        return None

    def how(self) -> Mapping[str, int]:
        """Return how many answers were paired with their requests, by the way it was done."""
        total = {how.value: sum(p.counts[how] for p in self._pairings.values()) for how in How}
        return {how: n for how, n in total.items() if n}

    def forget(self, name: str) -> None:
        """Forget a member that is gone, and its requests."""
        self._pairings.pop(name, None)

    def unasked(self, name: str) -> Undelivered | None:
        """Return whether what a member says unasked counts: the last one in use is heard until the next one speaks."""
        if name == self._scheduler.current:
            self._speaker = name
            return None
        return None if name == self._speaker else Undelivered.STANDBY
