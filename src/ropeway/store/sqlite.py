"""Keeps last values in one SQLite file: the default. A write is on the disk before it counts as done."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from ropeway.errors import StoreUnavailable
from ropeway.store.entry import Entry, Key

__all__ = ["SqliteBackend"]

_TABLES: Final = """
CREATE TABLE IF NOT EXISTS last_values (
    system TEXT NOT NULL, topic TEXT NOT NULL, data BLOB NOT NULL, version INTEGER NOT NULL,
    stamp_ns INTEGER NOT NULL, origin TEXT NOT NULL, type TEXT NOT NULL, form TEXT NOT NULL,
    PRIMARY KEY (system, topic)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS earlier_values (
    system TEXT NOT NULL, topic TEXT NOT NULL, data BLOB NOT NULL, version INTEGER NOT NULL,
    stamp_ns INTEGER NOT NULL, origin TEXT NOT NULL, type TEXT NOT NULL, form TEXT NOT NULL,
    PRIMARY KEY (system, topic, version, origin)
);
"""
_FIELDS: Final = "system, topic, data, version, stamp_ns, origin, type, form"
_KEEP: Final = f"""
INSERT INTO last_values ({_FIELDS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)
ON CONFLICT (system, topic) DO UPDATE SET data = excluded.data, version = excluded.version,
    stamp_ns = excluded.stamp_ns, origin = excluded.origin, type = excluded.type, form = excluded.form
WHERE (excluded.version, excluded.origin) > (version, origin)
"""  # noqa: S608 - constants
_AGE: Final = f"""
INSERT OR REPLACE INTO earlier_values ({_FIELDS})
SELECT {_FIELDS} FROM last_values WHERE system = ? AND topic = ? AND (version, origin) <> (?, ?)
"""  # noqa: S608 - constants
_LATE: Final = f"INSERT OR REPLACE INTO earlier_values ({_FIELDS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?)"  # noqa: S608
_TRIM: Final = """
DELETE FROM earlier_values WHERE system = ?1 AND topic = ?2 AND (version, origin) NOT IN (
    SELECT version, origin FROM earlier_values WHERE system = ?1 AND topic = ?2
    ORDER BY version DESC, origin DESC LIMIT ?3)
"""
_BUSY_S: Final = 5.0
_OF_ONE_ROW: Final = (sqlite3.DataError, sqlite3.InterfaceError, OverflowError, UnicodeError)


class SqliteBackend:
    """Keeps values in the file ``path``, which is made with its directories; ``:memory:`` keeps them in this process
    only.
    """

    def __init__(self, path: str) -> None:
        self.url = path
        self._path = path
        self._db: sqlite3.Connection | None = None

    def open(self) -> None:
        """Open or make the file."""
        self.close()
        with self._told():
            if self._path != ":memory:":
                Path(self._path).expanduser().parent.mkdir(parents=True, exist_ok=True)
            path = self._path if self._path == ":memory:" else str(_private(Path(self._path).expanduser()))
            db = sqlite3.connect(path, timeout=_BUSY_S, isolation_level=None, check_same_thread=False)
            try:
                db.execute("PRAGMA journal_mode = WAL")
                db.execute("PRAGMA synchronous = FULL")
                db.executescript(_TABLES)
            except sqlite3.Error:
                db.close()
                raise
            self._db = db

    def load(self) -> list[Entry]:
        """Return every last value."""
        with self._told():
            rows = self._opened().execute(f"SELECT {_FIELDS} FROM last_values").fetchall()  # noqa: S608 - constant
        return [Entry(*row) for row in rows]

    def write(self, entries: list[Entry], depth: int) -> dict[Key, str]:
        """Keep entries in one transaction, which is on the disk when this returns."""
        try:
            self._write(entries, depth)
        except _OF_ONE_ROW:
            return self._write_each(entries, depth)
        return {}

    def _write_each(self, entries: list[Entry], depth: int) -> dict[Key, str]:
        """Keep entries one by one; return what is wrong with those that cannot be kept."""
        bad: dict[Key, str] = {}
        for entry in entries:
            try:
                self._write([entry], depth)
            except _OF_ONE_ROW as error:
                bad[entry.key] = str(error)
        return bad

    def _write(self, entries: list[Entry], depth: int) -> None:
        with self._told(), self._transaction() as db:
            if not depth:
                db.executemany(_KEEP, [_row(e) for e in entries])
                return
            for entry in entries:
                row = _row(entry)
                before = db.execute(
                    "SELECT version, origin FROM last_values WHERE system = ? AND topic = ?", entry.key
                ).fetchone()
                if before is not None and tuple(before) > entry.order:
                    db.execute(_LATE, row)
                else:
                    db.execute(_AGE, (*entry.key, *entry.order))
                    db.execute(_KEEP, row)
            for key in {entry.key for entry in entries}:
                db.execute(_TRIM, (*key, depth))

    def remove(self, keys: list[Key]) -> None:
        """Forget topics."""
        with self._told(), self._transaction() as db:
            for table in ("last_values", "earlier_values"):
                db.executemany(f"DELETE FROM {table} WHERE system = ? AND topic = ?", keys)  # noqa: S608 - constants

    def history(self, key: Key) -> list[Entry]:
        """Return the values before the last one, newest first."""
        query = (
            f"SELECT {_FIELDS} FROM earlier_values WHERE system = ? AND topic = ? ORDER BY version DESC, origin DESC"  # noqa: S608 - constant
        )
        with self._told():
            return [Entry(*row) for row in self._opened().execute(query, key)]

    def close(self) -> None:
        """Close the file."""
        if self._db is not None:
            self._db.close()
            self._db = None

    def _opened(self) -> sqlite3.Connection:
        if self._db is None:
            raise StoreUnavailable(self.url, "is not open")
        return self._db

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except _OF_ONE_ROW:
            raise
        except sqlite3.DatabaseError as error:
            raise StoreUnavailable(self.url, _advice(error)) from error
        except OSError as error:
            raise StoreUnavailable(self.url, f"{error.strerror or error}; is its directory writable?") from error

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        db = self._opened()
        db.execute("BEGIN IMMEDIATE")
        try:
            yield db
            db.execute("COMMIT")
        except BaseException:
            with contextlib.suppress(sqlite3.Error):
                db.execute("ROLLBACK")
            raise


def _private(path: Path) -> Path:
    """Make the file so that only its owner may read it; one that is there stays as it is."""
    with contextlib.suppress(FileExistsError):
        os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600))
    return path


def _row(entry: Entry) -> tuple[str, str, bytes, int, int, str, str, str]:
    e = entry
    return e.system, e.topic, e.data, e.version, e.stamp_ns, e.origin, e.type, e.form


def _advice(error: sqlite3.DatabaseError) -> str:
    text = str(error)  # of SQLite, which does not change it; the name of the error is not to be had in Python 3.10
    if "disk is full" in text:
        return "the disk is full; free some space and it goes on by itself"
    if "is locked" in text:
        return "another program holds it locked"
    if "malformed" in text or "not a database" in text:
        return f"{text}; it is not a store, or a damaged one: move it away"
    return text
