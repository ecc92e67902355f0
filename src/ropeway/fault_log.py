"""Counts bad input, and logs it once per kind and minute, so that it never gets in anybody else's way."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable
from typing import Final

__all__ = ["ABSENT", "FaultLog"]

log = logging.getLogger("ropeway.link")

_QUIET_S: Final = 60.0
_KINDS_LIMIT: Final = 1024  # a hostile peer invents topics; the table does not grow with them
_TOPIC_LIMIT: Final = 200  # characters of what a peer sends that are kept and shown
_TEXT_LIMIT: Final = 500


class _Absent:
    __slots__ = ()

    def __repr__(self) -> str:
        return "ABSENT"

    def __bool__(self) -> bool:
        return False


ABSENT: Final = _Absent()
"""The id of an operation that has none."""


class FaultLog:
    """Counts what one peer did wrong, and logs it at a limited rate.

    ``counts`` maps (kind, topic) to how often. Kinds are short words: ``frame``, ``operation``, ``type``,
    ``message``, ``size``, ``unknown topic``. What the peer sent is kept and logged in short and printable form.
    """

    def __init__(self, peer: str, clock: Callable[[], float] = time.monotonic) -> None:
        self.peer = peer
        self.counts: Counter[tuple[str, str]] = Counter()
        self.on_note: Callable[[str, str, object], None] = _nobody
        self._clock = clock
        self._said: dict[str, float] = {}  # by kind: when the log told of it
        self._unsaid: Counter[str] = Counter()

    def note(self, kind: str, topic: str, text: object, *, id: object = ABSENT) -> None:
        """Count one fault, and say so in the log if none of its kind was told within the last minute.

        ``on_note`` is called for each, with the kind, the text and the ``id`` of the operation that was at fault.
        """
        topic = _shown(topic, _TOPIC_LIMIT)
        key = (kind, topic)
        if key not in self.counts and len(self.counts) >= _KINDS_LIMIT:
            key = (kind, "(other)")
        self.counts[key] += 1
        self.on_note(kind, _shown(str(text), _TEXT_LIMIT), id)
        now = self._clock()
        if now - self._said.get(kind, float("-inf")) < _QUIET_S:
            self._unsaid[kind] += 1
            return
        self._said[kind] = now
        unsaid = self._unsaid.pop(kind, 0)
        more = f" ({unsaid} more since the last such line)" if unsaid else ""
        where = f" on {topic}" if topic else ""
        log.warning("%s: bad %s%s: %s%s", self.peer, kind, where, _shown(str(text), _TEXT_LIMIT), more)

    @property
    def total(self) -> int:
        """The number of faults."""
        return sum(self.counts.values())


def _nobody(kind: str, text: str, id: object) -> None:
    """Ignore the fault: nobody listens."""


def _shown(text: str, limit: int) -> str:
    short = text if len(text) <= limit else f"{text[: limit - 1]}…"
    return short if short.isprintable() else short.encode("unicode_escape").decode("ascii")[: 2 * limit]
