"""The audit log of a process: takes notes at once, and writes them in a thread of its own.

Notes wait in a queue that is bounded in bytes. What does not fit, or cannot be written, is counted, and the log says
how much that was as soon as it can. The last entries stay in memory, so that they can be read whatever the disk does.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections import Counter, deque
from collections.abc import AsyncGenerator, Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from ropeway import aio
from ropeway.audit.files import AuditLine
from ropeway.audit.merging import AuditEntry, Merger
from ropeway.audit.note import AuditNote
from ropeway.fault_log import FaultLog
from ropeway.limits import AUDIT_KEPT, AUDIT_QUEUE_BYTES, AUDIT_SCAN_BYTES
from ropeway.tasks import describe

__all__ = ["AuditQuery", "AuditSink", "AuditTrail"]

log = logging.getLogger("ropeway.audit")

_TRY_AGAIN_S: Final = 10.0  # a disk that was full
_CLOSE_S: Final = 5.0  # for a disk that takes its time


class AuditSink(Protocol):
    """Keeps entries; ``AuditFiles`` is one. All methods block."""

    def open(self) -> int:
        """Be ready to append; return the number of the last entry. Raises ``OSError``. Harmless twice."""
        ...

    def append(self, entries: Sequence[AuditEntry]) -> None:
        """Append entries: all of them, or none. Raises ``OSError``."""
        ...

    def backwards(self, wanted: Callable[[bytes], bool], before: int | None) -> Iterable[AuditLine]:
        """Yield lines, the newest first: those before a number, if one is given.

        ``wanted`` looks at a line before it is read as JSON. Raises ``OSError``.
        """
        ...

    def close(self) -> None:
        """Close what is open. Harmless twice."""
        ...


@dataclass(frozen=True)
class AuditQuery:
    """Says which entries to read: the newest ``count`` of those that fit.

    ``kinds``, ``who``, ``where`` and ``name`` choose by what an entry says, texts by a part of them; ``since_s`` and
    ``until_s`` by time, ``after`` and ``before`` by number.
    """

    count: int = 100
    kinds: frozenset[str] = frozenset()
    who: str = ""
    where: str = ""
    name: str = ""
    since_s: float = 0.0
    until_s: float = float("inf")
    after: int = 0
    before: int | None = None

    def fits(self, entry: AuditEntry) -> bool:
        """Return whether an entry is wanted."""
        if self.kinds and entry.get("kind") not in self.kinds:
            return False
        if not self.since_s <= entry.get("time", 0.0) <= self.until_s:
            return False
        if entry["number"] <= self.after or (self.before is not None and entry["number"] >= self.before):
            return False
        return all(text in str(entry.get(key, "")) for key, text in self._texts())

    def may_fit(self, line: bytes) -> bool:
        """Return whether an entry may be wanted, by its line: most are not, and need not be read as JSON."""
        return not self.kinds or any(f'"kind":"{kind}"'.encode() in line for kind in self.kinds)

    def _texts(self) -> Iterable[tuple[str, str]]:
        return (("who", self.who), ("where", self.where), ("name", self.name))


class AuditTrail:
    """Takes notes for ``sink``; the thread begins with the first."""

    def __init__(
        self,
        sink: AuditSink,
        *,
        merger: Merger | None = None,
        queue_bytes: int = AUDIT_QUEUE_BYTES,
        kept: int = AUDIT_KEPT,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._sink, self._merger = sink, merger or Merger()
        self._room_bytes = self._free_bytes = queue_bytes
        self._clock = clock
        self._changed = threading.Condition()
        self._waiting: deque[AuditNote] = deque()
        self._merged: deque[AuditEntry] = deque()  # of workers
        self._lost: Counter[str] = Counter()  # by kind: what did not fit, and was not told yet
        self._all_lost = 0
        self._unwritten: deque[AuditEntry] = deque(maxlen=kept)
        self._ring: deque[AuditEntry] = deque(maxlen=kept)
        self._forgotten: Counter[str] = Counter()  # by kind: what could not be written until it fell out
        self._last = 0
        self._retry_s = float("-inf")
        self._error = ""
        self._thread: threading.Thread | None = None
        self._closing = False
        self._fault_log = FaultLog("audit")
        self._followers: set[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = set()

    # ── taking notes ───────────────────────────────────────────────────────────────────────────────────────────

    def note(self, note: AuditNote) -> None:
        """See ``Auditor``."""
        with self._changed:
            size = note.size_bytes
            if size > self._free_bytes or self._closing:
                self._lost[note.kind] += 1
                self._all_lost += 1
            else:
                self._free_bytes -= size
                self._waiting.append(note)
            self._wake()

    def take_entries(self, entries: Iterable[AuditEntry]) -> None:
        """Take entries that a worker has made of its notes."""
        with self._changed:
            for entry in entries:
                if len(self._merged) < (self._ring.maxlen or 0):
                    self._merged.append(entry)
                else:
                    self._lost[str(entry.get("kind"))] += 1
                    self._all_lost += 1
            self._wake()

    def _wake(self) -> None:
        if self._thread is None and not self._closing:
            self._thread = threading.Thread(target=self._run, name="audit", daemon=True)
            self._thread.start()
        self._changed.notify()

    # ── the thread ─────────────────────────────────────────────────────────────────────────────────────────────

    def _run(self) -> None:
        while True:
            notes, entries, closing = self._wait()
            try:
                self._write([*entries, *self._entries_of(notes, closing=closing)])
            except Exception as error:  # the log is not worth a gateway; whoever reads it sees the gap
                log.exception("the audit log lost entries: %s", describe(error))
            finally:
                with self._changed:
                    self._free_bytes += sum(note.size_bytes for note in notes)
            if closing:
                return

    def _wait(self) -> tuple[list[AuditNote], list[AuditEntry], bool]:
        with self._changed:
            while not (self._waiting or self._merged or self._closing or (left_s := self._left_s()) == 0):
                self._changed.wait(left_s)
            notes, entries = list(self._waiting), list(self._merged)
            self._waiting.clear()
            self._merged.clear()
            return notes, entries, self._closing

    def _left_s(self) -> float | None:
        """Return for how long there is nothing to do: until the window of the merger ends, or the disk may be back."""
        dues = [] if self._merger.ends_s is None else [self._merger.ends_s]
        if self._unwritten:
            dues.append(self._retry_s)
        return max(min(dues) - self._clock(), 0.0) if dues else None

    def _entries_of(self, notes: Sequence[AuditNote], *, closing: bool) -> list[AuditEntry]:
        found: list[AuditEntry] = []
        for note in notes:
            found += self._merger.take(note, self._clock())
        found += self._merger.end(self._clock(), closing=closing)
        with self._changed:
            lost, self._lost = self._lost, Counter()
        if lost:
            found.append(_gap("lost", lost, "they came faster than they could be written"))
        return found

    def _write(self, entries: list[AuditEntry]) -> None:
        """Number entries and keep them; write them, after what could not be written before."""
        entries = [{"number": self._next_number(), **entry} for entry in entries]
        with self._changed:
            self._ring.extend(entries)
        for entry in entries:
            if len(self._unwritten) == self._unwritten.maxlen:
                self._forgotten[str(self._unwritten[0]["kind"])] += 1
            self._unwritten.append(entry)
        if self._unwritten and self._clock() >= self._retry_s:
            try:
                self._append()
            except OSError as error:
                self._error = error.strerror or str(error)
                self._retry_s = self._clock() + _TRY_AGAIN_S
                self._fault_log.note(
                    "write", "", f"{self._error}; the last entries are kept in memory, and tried again"
                )
        if entries:
            self._tell()

    def _next_number(self) -> int:
        """Return a number above all others: the time in µs, so that it grows whether or not the files can be read."""
        self._last = max(self._last + 1, time.time_ns() // 1_000)
        return self._last

    def _append(self) -> None:
        """Write what waits, and how much was forgotten meanwhile. Raises ``OSError``."""
        self._last = max(self._last, self._sink.open())
        gap = []
        if self._forgotten:
            said = _gap("forgotten", self._forgotten, f"they could not be written: {self._error}")
            gap.append({"number": self._unwritten[0]["number"] - 1, **said})
        self._sink.append([*gap, *self._unwritten])
        self._forgotten.clear()
        self._unwritten.clear()
        self._error = ""

    def _tell(self) -> None:
        with self._changed:
            followers = list(self._followers)
        for loop, event in followers:
            with contextlib.suppress(RuntimeError):  # its loop has been closed
                loop.call_soon_threadsafe(event.set)

    # ── reading ────────────────────────────────────────────────────────────────────────────────────────────────

    def read(self, query: AuditQuery, *, scan_bytes: int = AUDIT_SCAN_BYTES) -> tuple[list[AuditEntry], int | None]:
        """Return entries, the oldest first, and the number before which there may be more. Blocks.

        At most ``scan_bytes`` of the files are looked through. Where they cannot be read, what is in memory counts.
        """
        held = self._held()
        found = [entry for entry in reversed(held) if query.fits(entry)][: query.count]
        oldest = held[0]["number"] if held else None
        before = min((number for number in (oldest, query.before) if number is not None), default=None)
        more = None
        if len(found) == query.count:
            more = found[-1]["number"] if found else None
        elif oldest is None or query.after < oldest:
            more = self._read_files(query, before, scan_bytes, found)
        return found[::-1], more

    def _read_files(
        self, query: AuditQuery, before: int | None, scan_bytes: int, found: list[AuditEntry]
    ) -> int | None:
        """Add to what was found; return the number before which there may be more."""
        try:
            for line in self._sink.backwards(query.may_fit, before):
                if line.number <= query.after:
                    return None
                if line.entry is not None and query.fits(line.entry):
                    found.append(line.entry)
                scan_bytes -= line.size_bytes
                if len(found) == query.count or scan_bytes <= 0:
                    return line.number
        except OSError as error:
            self._error = f"the files cannot be read: {error.strerror or error}"
        return None

    def _held(self) -> list[AuditEntry]:
        with self._changed:
            return list(self._ring)

    async def follow(self, query: AuditQuery, *, idle_s: float) -> AsyncGenerator[AuditEntry | None, None]:
        """Yield entries behind number ``query.after`` as they come; ``None`` where nothing came for ``idle_s``.

        A reader that is slower than the entries come misses those that are no longer in memory.
        """
        event = asyncio.Event()
        follower = (asyncio.get_running_loop(), event)
        after = query.after
        with self._changed:
            self._followers.add(follower)
        try:
            while not self._closing:
                event.clear()
                for entry in [entry for entry in self._held() if entry["number"] > after]:
                    after = entry["number"]
                    if query.fits(entry):
                        yield entry
                try:
                    async with aio.timeout(idle_s):
                        await event.wait()
                except TimeoutError:
                    yield None
        finally:
            with self._changed:
                self._followers.discard(follower)

    @property
    def last_number(self) -> int:
        """The number of the last entry, 0 where there is none."""
        return self._last

    def status(self) -> dict[str, Any]:
        """Return how the log is, as JSON."""
        return {"lost": self._all_lost, "unwritten": len(self._unwritten), "error": self._error}

    def close(self) -> None:
        """Write what waits, and end. Blocks; harmless twice."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join(_CLOSE_S)
        self._sink.close()
        self._tell()


def _gap(operation: str, counts: Counter[str], why: str) -> AuditEntry:
    return {
        "time": time.time(),
        "kind": "audit",
        "who": "",
        "where": "",
        "operation": operation,
        "name": "",
        "outcome": "failed",
        "why": why,
        "times": counts.total(),
        "details": {"kinds": dict(counts)},
    }
