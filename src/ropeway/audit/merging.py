"""Merges notes that repeat themselves, so that nobody fills the audit log by trying again. Without clock and files.

What is new is an entry at once. The same again within a window is counted, and becomes one entry with ``times`` when
the window ends. So does what one sender does beyond a number of different entries: one entry says how many more there
were, and the hash over the hashes of their payloads.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from ropeway.audit.note import AuditNote
from ropeway.limits import (
    AUDIT_ENTRIES_PER_SENDER,
    AUDIT_NAME_CHARACTERS,
    AUDIT_SENDERS,
    AUDIT_TEXT_CHARACTERS,
    AUDIT_WINDOW_S,
)

__all__ = ["AuditEntry", "Merger"]

AuditEntry = dict[str, Any]
"""An entry of the log, as JSON."""

_SEVERAL: Final = "(several)"
_OTHERS: Final = "(others)"


class _Sender(NamedTuple):
    kind: str
    who: str
    host: str


@dataclass(slots=True)
class _Again:
    """Counts what came after an entry that it is the same as."""

    entry: AuditEntry
    times: int = 0
    last_s: float = 0.0


@dataclass(slots=True)
class _More:
    """Counts what a sender did: entries of its own, and the rest together."""

    entries: int = 0
    times: int = 0
    since_s: float = 0.0
    last_s: float = 0.0
    operation: str = ""
    hashes: Any = None


class Merger:
    """Turns notes into entries."""

    def __init__(
        self,
        *,
        window_s: float = AUDIT_WINDOW_S,
        per_sender: int = AUDIT_ENTRIES_PER_SENDER,
        senders: int = AUDIT_SENDERS,
    ) -> None:
        self._window_s, self._per_sender, self._most_senders = window_s, per_sender, senders
        self._again: dict[tuple[Any, ...], _Again] = {}
        self._senders: dict[_Sender, _More] = {}
        self._ends_s: float | None = None

    @property
    def ends_s(self) -> float | None:
        """The time at which the window ends, ``None`` while nothing has come."""
        return self._ends_s

    def take(self, note: AuditNote, now_s: float) -> Iterator[AuditEntry]:
        """Yield the entry of a note, if it gets one of its own. ``now_s`` is of the clock that ``end`` gets, too."""
        if self._ends_s is None:
            self._ends_s = now_s + self._window_s
        entry = _entry(note)
        sender = _Sender(note.kind, entry["who"], _host(entry["where"]))
        key = (*sender, *(entry.get(field) for field in ("operation", "name", "outcome", "why", "sha256")))
        again = self._again.get(key)
        if again is not None:
            again.times += 1
            again.last_s = note.time_s
            return
        more = self._senders.get(sender)
        if more is None:
            if len(self._senders) >= self._most_senders:
                sender = _Sender(note.kind, _OTHERS, "")
            more = self._senders.setdefault(sender, _More())
        if more.entries < self._per_sender and sender.who != _OTHERS:
            more.entries += 1
            self._again[key] = _Again(entry)
            yield entry
        else:
            _count(more, note, entry)

    def end(self, now_s: float, *, closing: bool = False) -> Iterator[AuditEntry]:
        """Yield what was counted, if the window has ended, and begin anew."""
        if self._ends_s is None or (now_s < self._ends_s and not closing):
            return
        for again in self._again.values():
            if again.times:
                yield {**again.entry, "time": again.last_s, "times": again.times, "since": again.entry["time"]}
        for sender, more in self._senders.items():
            if more.times:
                yield _rest(sender, more)
        self._again.clear()
        self._senders.clear()
        self._ends_s = None


def _entry(note: AuditNote) -> AuditEntry:
    entry: AuditEntry = {
        "time": round(note.time_s, 6),
        "kind": note.kind,
        "who": _short(note.who),
        "where": _short(note.where),
        "operation": _short(note.operation),
        "name": _short(note.name),
        "outcome": note.outcome,
    }
    if note.why:
        entry["why"] = _short(note.why, AUDIT_TEXT_CHARACTERS)
    if note.payload is not None:
        entry["bytes"] = len(note.payload)
        entry["sha256"] = hashlib.sha256(note.payload).hexdigest()
    if note.details:
        entry["details"] = dict(note.details)
    return entry


def _count(more: _More, note: AuditNote, entry: AuditEntry) -> None:
    more.since_s = more.since_s or note.time_s
    more.last_s = note.time_s
    more.operation = entry["operation"] if more.operation in ("", entry["operation"]) else _SEVERAL
    more.times += 1
    if "sha256" in entry:
        more.hashes = more.hashes or hashlib.sha256()
        more.hashes.update(bytes.fromhex(entry["sha256"]))


def _rest(sender: _Sender, more: _More) -> AuditEntry:
    entry: AuditEntry = {
        "time": round(more.last_s, 6),
        "kind": sender.kind,
        "who": sender.who,
        "where": sender.host,
        "operation": more.operation,
        "name": _SEVERAL,
        "outcome": "several",
        "times": more.times,
        "since": round(more.since_s, 6),
    }
    if more.hashes is not None:
        entry["sha256_of_hashes"] = more.hashes.hexdigest()
    return entry


def _host(where: str) -> str:
    """Return an address without the port, which is another for each connection."""
    host, colon, port = where.rpartition(":")
    return host if colon and port.isdigit() else where


def _short(text: str, limit: int = AUDIT_NAME_CHARACTERS) -> str:
    """Return a text that a peer may have chosen: short, and printable whatever stands in it."""
    short = text if len(text) <= limit else f"{text[: limit - 1]}…"
    return short if short.isprintable() else short.encode("unicode_escape").decode("ascii")[: 2 * limit]
