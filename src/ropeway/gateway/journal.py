"""Remembers every configuration that was applied: who, when, from where, and what changed; on disk before it counts.

One SQLite file per configuration file. An entry is written as ``pending`` before anything is changed, and becomes
``up`` once everything runs; only then is the change confirmed. After a crash at any moment, what is ``up`` is what was
confirmed. All methods block, and threads take turns: a thread whose caller no longer waits, as its task was cancelled,
may still be at work when another closes the file.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import sqlite3
import threading
import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from ropeway.errors import JournalError
from ropeway.limits import JOURNAL_BYTES, JOURNAL_ENTRIES

__all__ = ["Journal", "JournalEntry"]

_VERSION: Final = 1
_SCHEMA: Final = f"""
CREATE TABLE IF NOT EXISTS contents (etag TEXT PRIMARY KEY, packed BLOB NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS entries (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    time_s REAL NOT NULL,
    who TEXT NOT NULL,
    place TEXT NOT NULL,
    action TEXT NOT NULL,
    source TEXT NOT NULL,
    file_digest TEXT NOT NULL,
    etag TEXT NOT NULL REFERENCES contents (etag),
    state TEXT NOT NULL,
    note TEXT NOT NULL,
    plan TEXT NOT NULL
);
CREATE INDEX IF NOT EXISTS states ON entries (state, number);
PRAGMA user_version = {_VERSION};
"""
_COLUMNS: Final = "number, time_s, who, place, action, source, file_digest, etag, state, note, plan"
_PACK_LEVEL: Final = 1
_KEPT_AFTER_PRUNING: Final = 0.9
_PRUNED_EVERY: Final = 64  # confirmed changes
_CHECKED_BYTES: Final = 64 << 20  # a larger file would take longer than a start should


@dataclass(frozen=True, slots=True)
class JournalEntry:
    """A change. ``state`` is ``pending``, ``up`` or ``failed``; ``file_digest`` is of the file as it was then.

    ``note`` says why it failed, or what somebody wanted to say; ``plan`` has the steps.
    """

    who: str
    place: str
    action: str
    source: str
    file_digest: str
    etag: str
    note: str = ""
    plan: tuple[dict[str, Any], ...] = ()
    state: str = "pending"
    time_s: float = 0.0
    number: int = 0

    def to_json(self) -> dict[str, Any]:
        """Return the entry for people and programs."""
        return {
            "number": self.number,
            "time": self.time_s,
            "who": self.who,
            "from": self.place,
            "action": self.action,
            "source": self.source,
            "etag": self.etag,
            "state": self.state,
            "note": self.note,
            "steps": list(self.plan),
        }


class Journal:
    """The journal in a file, which only one process has open."""

    def __init__(self, path: Path, *, most_entries: int = JOURNAL_ENTRIES, most_bytes: int = JOURNAL_BYTES) -> None:
        """Open it. Raises ``JournalError`` where it cannot be had; a damaged one is put aside, and a new one begun."""
        self.path = path
        self.set_aside: Path | None = None
        self._most, self._most_bytes = most_entries, most_bytes
        self._turn = threading.RLock()  # SQLite ends the process where a connection is closed under another thread
        with self._told():
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._lock = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            self._take_lock()
            self._db: sqlite3.Connection | None = self._opened()
        except BaseException:
            os.close(self._lock)
            raise

    def close(self) -> None:
        """Close it, after what is being written; once closed, everything else raises ``JournalError``."""
        with self._turn:
            if self._db is not None:
                self._db.close()
                self._db = None
                os.close(self._lock)

    def begin(self, entry: JournalEntry, config: dict[str, Any]) -> JournalEntry:
        """Write down what is about to be done; return it with its number. It is on disk then."""
        made = replace(entry, time_s=time.time())
        packed = zlib.compress(json.dumps(config, sort_keys=True).encode(), _PACK_LEVEL)
        with self._transaction() as db:
            db.execute("INSERT OR IGNORE INTO contents VALUES (?, ?)", (made.etag, packed))
            cursor = db.execute(
                "INSERT INTO entries (time_s, who, place, action, source, file_digest, etag, state, note, plan)"
                " VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    made.time_s,
                    made.who,
                    made.place,
                    made.action,
                    made.source,
                    made.file_digest,
                    made.etag,
                    made.state,
                    made.note,
                    json.dumps(made.plan),
                ),
            )
        return replace(made, number=cursor.lastrowid or 0)

    def confirm(self, number: int) -> None:
        """Write down that it runs; it is on disk then, and restored at the next start."""
        with self._transaction() as db:
            db.execute("UPDATE entries SET state = 'up' WHERE number = ?", (number,))
        if number % _PRUNED_EVERY == 0:
            with contextlib.suppress(JournalError):  # it is tried again
                self._prune()

    def fail(self, number: int, note: str) -> None:
        """Write down that it does not run, and why."""
        with self._transaction() as db:
            db.execute("UPDATE entries SET state = 'failed', note = ? WHERE number = ?", (note, number))

    def history(self, *, count: int = 20, before: int | None = None) -> list[JournalEntry]:
        """Return the last entries, the newest first; those before a number if given."""
        with self._connection() as db:
            rows = db.execute(
                f"SELECT {_COLUMNS} FROM entries WHERE number < ? ORDER BY number DESC LIMIT ?",  # noqa: S608 - constant
                (before if before is not None else 1 << 62, count),
            ).fetchall()
            return [_entry(row) for row in rows]

    def entry(self, number: int) -> JournalEntry | None:
        """Return an entry, if there is one of the number."""
        found = self.history(count=1, before=number + 1)
        return found[0] if found and found[0].number == number else None

    def last_up(self, before: int | None = None) -> JournalEntry | None:
        """Return the last entry that came up, or the last one before a number."""
        with self._connection() as db:
            row = db.execute(
                f"SELECT {_COLUMNS} FROM entries WHERE state = 'up' AND number < ? "  # noqa: S608 - constant
                "ORDER BY number DESC LIMIT 1",
                (before if before is not None else 1 << 62,),
            ).fetchone()
            return None if row is None else _entry(row)

    def config(self, entry: JournalEntry) -> dict[str, Any]:
        """Return the configuration of an entry, in the full form."""
        return self.content(entry.etag)

    def content(self, etag: str) -> dict[str, Any]:
        """Return the configuration of an etag, in the full form. Raises ``JournalError`` where it is not there."""
        with self._connection() as db:
            row = db.execute("SELECT packed FROM contents WHERE etag = ?", (etag,)).fetchone()
            if row is None:
                raise JournalError(str(self.path), f"the configuration {etag} is not there")
            found: dict[str, Any] = json.loads(zlib.decompress(row[0]))
            return found

    def _take_lock(self) -> None:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise JournalError(str(self.path), "another gateway that runs the same file has it") from None

    def _opened(self) -> sqlite3.Connection:
        try:
            return self._connect()
        except (sqlite3.DatabaseError, ValueError) as error:
            if isinstance(error, sqlite3.OperationalError):  # it is sound, and cannot be opened
                raise JournalError(str(self.path), str(error)) from None
            self.set_aside = self.path.with_name(f"{self.path.name}.damaged-{int(time.time())}")
        with self._told():
            self.path.rename(self.set_aside)
            for suffix in ("-wal", "-shm"):
                Path(f"{self.path}{suffix}").unlink(missing_ok=True)
            return self._connect()

    def _connect(self) -> sqlite3.Connection:
        made = sqlite3.connect(self.path, check_same_thread=False)
        try:
            self.path.chmod(0o600)
            small = self.path.stat().st_size <= _CHECKED_BYTES
            if small and made.execute("PRAGMA quick_check(1)").fetchone()[0] != "ok":
                raise sqlite3.DatabaseError("damaged")
            made.execute("PRAGMA journal_mode = WAL")
            made.execute("PRAGMA synchronous = FULL")
            made.execute("PRAGMA busy_timeout = 1000")
            if made.execute("PRAGMA user_version").fetchone()[0] != _VERSION:
                made.executescript(_SCHEMA)
            for row in made.execute(f"SELECT {_COLUMNS} FROM entries ORDER BY number DESC LIMIT 3"):  # noqa: S608
                _entry(row)
        except BaseException:
            made.close()
            raise
        return made

    def _prune(self) -> None:
        """Forget the oldest entries above the limits, but never the last that came up."""
        with self._transaction() as db:
            (count,) = db.execute("SELECT count(*) FROM entries").fetchone()
            (size,) = db.execute("SELECT coalesce(sum(length(packed)), 0) FROM contents").fetchone()
            share = min(self._most / max(count, 1), self._most_bytes / max(size, 1))
            if share >= 1:
                return
            leaves = int(count * share * _KEPT_AFTER_PRUNING)
            db.execute(
                "DELETE FROM entries WHERE number NOT IN (SELECT number FROM entries ORDER BY number DESC LIMIT ?)"
                " AND number <> (SELECT max(number) FROM entries WHERE state = 'up')",
                (max(leaves, 1),),
            )
            db.execute("DELETE FROM contents WHERE etag NOT IN (SELECT etag FROM entries)")

    @contextlib.contextmanager
    def _connection(self) -> Iterator[sqlite3.Connection]:
        """Have the database for oneself. Raises ``JournalError``, also where it is closed."""
        with self._turn, self._told():
            if self._db is None:
                raise JournalError(str(self.path), "it is closed")
            yield self._db

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """Have the database for changes that are all made or none."""
        with self._connection() as db, db:
            yield db

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        """Raise ``JournalError`` for whatever a database or a file system raises."""
        try:
            yield
        except (sqlite3.Error, OSError, zlib.error, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            raise JournalError(str(self.path), reason) from None


def _entry(row: tuple[Any, ...]) -> JournalEntry:
    number, time_s, who, place, action, source, file_digest, etag, state, note, plan = row
    return JournalEntry(
        who, place, action, source, file_digest, etag, note, tuple(json.loads(plan)), state, time_s, number
    )
