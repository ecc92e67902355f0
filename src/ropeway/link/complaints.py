"""Bad input: counted always, logged once per kind and minute, never in the way of anybody else."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable
from typing import Final

__all__ = ["Complaints"]

log = logging.getLogger("ropeway.link")

_QUIET_S: Final = 60.0
_KINDS_LIMIT: Final = 1024  # a hostile peer invents topics; the table does not grow with them


class Complaints:
    """What one peer did wrong.

    ``counts`` maps (kind, topic) to how often. Kinds are short words: ``frame``, ``operation``, ``type``,
    ``message``, ``size``, ``unknown topic``.
    """

    def __init__(self, peer: str, clock: Callable[[], float] = time.monotonic) -> None:
        self.peer = peer
        self.counts: Counter[tuple[str, str]] = Counter()
        self._clock = clock
        self._said: dict[tuple[str, str], tuple[float, int]] = {}

    def note(self, kind: str, topic: str, text: object) -> None:
        """Count one fault, and say so in the log if it was not said within the last minute."""
        key = (kind, topic)
        if key not in self.counts and len(self.counts) >= _KINDS_LIMIT:
            key = (kind, "(other)")
        self.counts[key] += 1
        now = self._clock()
        said = self._said.get(key)
        if said is not None and now - said[0] < _QUIET_S:
            return
        since = self.counts[key] - (said[1] if said else 0)
        self._said[key] = (now, self.counts[key])
        more = f" ({since} times since the last such line)" if said and since > 1 else ""
        log.warning("%s: bad %s%s: %s%s", self.peer, kind, f" on {topic}" if topic else "", text, more)

    @property
    def total(self) -> int:
        """How many faults there were."""
        return sum(self.counts.values())
