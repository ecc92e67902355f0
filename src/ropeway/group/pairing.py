"""Tells which request a message on a response topic answers. Sans-I/O.

A machine that is called over two topics names the request in its answer at best by the time stamp in the header, which
most perception nodes copy from the picture to what they found in it. Where there is none, one request under way is the
one that is answered; where several are, they are taken to be answered in order. Which of the three it was is counted,
since the latencies of the last kind are a guess.
"""

from __future__ import annotations

import enum
from collections import Counter, OrderedDict, deque
from collections.abc import Hashable
from typing import Final

__all__ = ["How", "Pairing"]

_MOST: Final = 1024  # requests that are remembered
_GUESSED: Final = 64  # stamps by which it is learnt that answers carry those of their requests


class How(enum.Enum):
    """Says how a response was paired with its request."""

    STAMP = "equal header stamp"
    ONLY = "the only request under way"
    ORDER = "by order"


class Pairing:
    """The requests of one topic and their answers.

    ``key`` of a request is whatever tells it from others; ``stamp`` the time in its header, ``None`` without one. A
    request is answered once: ``answered`` gives its key for the first answer, and ``None`` for any other.
    """

    def __init__(self) -> None:
        self.counts: Counter[How] = Counter()
        self._open: OrderedDict[Hashable, Hashable | None] = OrderedDict()  # key: stamp
        self._by_stamp: dict[Hashable, Hashable] = {}
        self.stamped = False  # an answer has carried the stamp of a request: the others will, too
        self._guessed: deque[Hashable] = deque(maxlen=_GUESSED)  # stamps of requests that were paired otherwise

    def __len__(self) -> int:
        """Return how many requests have no answer."""
        return len(self._open)

    def asked(self, key: Hashable, stamp: Hashable | None) -> None:
        """Note a request."""
        if len(self._open) >= _MOST:
            self._close(next(iter(self._open)))
        self._open[key] = stamp
        if stamp is not None:
            self._by_stamp[stamp] = key

    def answered(self, stamp: Hashable | None) -> Hashable | None:
        """Return the key of the request that is answered, ``None`` if it is none that waits for an answer."""
        key = None if stamp is None else self._by_stamp.get(stamp)
        if key is not None:
            self.stamped = True
            self.counts[How.STAMP] += 1
        elif stamp is not None and (self.stamped or stamp in self._guessed):
            self.stamped = True
            return None  # it was answered before, or somebody else asked
        elif self._open:
            key = next(iter(self._open))
            self._guessed.append(self._open[key])
            self.counts[How.ONLY if len(self._open) == 1 else How.ORDER] += 1
        else:
            return None
        self._close(key)
        return key

    def unheard(self) -> list[Hashable]:
        """Note that answers are not heard for a while; return the keys of the requests that wait for one.

        Those without a stamp are forgotten: the answer that comes next is not theirs.
        """
        keys = list(self._open)
        for key in keys:
            if self._open[key] is None:
                del self._open[key]
        return keys

    def _close(self, key: Hashable) -> None:
        stamp = self._open.pop(key, None)
        if stamp is not None and self._by_stamp.get(stamp) == key:
            del self._by_stamp[stamp]
