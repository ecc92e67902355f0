"""Keeps last values as JSON files, one per topic in a directory per system: the layout of the IoRT paper's local file
system.

A file is replaced as a whole, so that a reader never sees half of one. Names are percent-encoded where a file system
would not take them, and cut with a hash at their end where they are too long then; the file has the whole name in it.
"""

from __future__ import annotations

import base64
import contextlib
import errno
import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from ropeway.errors import StoreUnavailable
from ropeway.store.entry import Entry, Key, as_json, whole
from ropeway.types.untrusted import json_value

__all__ = ["FilesBackend"]

_HISTORY: Final = ".history"
_LONGEST: Final = 200  # characters of a name as a file has it, without what is added; most systems take 255 bytes
_KEPT: Final = 150  # of a longer one, before its hash
_OF_ONE_FILE: Final = frozenset(
    (errno.ENAMETOOLONG, errno.EINVAL, errno.EILSEQ, errno.EISDIR, errno.ENOTDIR, errno.EEXIST, errno.ELOOP)
)  # what is wrong with one name, and not with the disk


class FilesBackend:
    """Keeps values under the directory ``path``: ``SYSTEM/TOPIC.json``; earlier ones in ``SYSTEM/TOPIC.history/``."""

    def __init__(self, path: str) -> None:
        self.url = path
        self._root = Path(path).expanduser()

    def open(self) -> None:
        """Make the directory."""
        with self._told():
            self._root.mkdir(parents=True, exist_ok=True)

    def load(self) -> list[Entry]:
        """Return every last value; other files are left alone."""
        with self._told():
            found = [entry for path in self._root.glob("*/*.json") if (entry := _read(path)) is not None]
        return sorted(found, key=lambda entry: (entry.key, entry.order))  # the last one of a topic counts

    def write(self, entries: list[Entry], depth: int) -> dict[Key, str]:
        """Keep entries, file by file; each is on the disk when this returns."""
        bad: dict[Key, str] = {}
        with self._told():
            touched: set[Path] = set()
            if not depth:
                entries = list({entry.key: entry for entry in entries}.values())
            for entry in entries:
                try:
                    touched.add(self._write(entry, depth))
                except OSError as error:
                    if error.errno not in _OF_ONE_FILE:
                        raise
                    bad[entry.key] = error.strerror or str(error)
                except ValueError as error:  # a text that is none
                    bad[entry.key] = str(error)
            for directory in touched:
                _sync_directory(directory)
        return bad

    def _write(self, entry: Entry, depth: int) -> Path:
        """Keep one entry; return the directory that has to be brought to the disk, too."""
        path = self._path(entry.key)
        path.parent.mkdir(exist_ok=True)
        before = _read(path) if path.exists() else None
        if before is not None and before.order > entry.order:
            self._archive(path, entry, depth)
            return path.parent
        if before is not None and before.order != entry.order:
            self._archive(path, before, depth)
        _replace(path, entry)
        return path.parent

    def remove(self, keys: list[Key]) -> None:
        """Forget topics."""
        with self._told():
            for key in keys:
                path = self._path(key)
                path.unlink(missing_ok=True)
                with contextlib.suppress(FileNotFoundError):
                    shutil.rmtree(path.with_suffix(_HISTORY))
                with contextlib.suppress(OSError):  # other topics are there
                    path.parent.rmdir()

    def history(self, key: Key) -> list[Entry]:
        """Return the values before the last one, newest first."""
        with self._told():
            found = [_read(path) for path in self._path(key).with_suffix(_HISTORY).glob("*.json")]
        return sorted((e for e in found if e is not None), key=lambda entry: entry.order, reverse=True)

    def close(self) -> None:
        """Do nothing: no file is held open."""

    def _path(self, key: Key) -> Path:
        system, topic = key
        return self._root / _file_name(system) / f"{_file_name(topic)}.json"

    def _archive(self, path: Path, entry: Entry, depth: int) -> None:
        if not depth:
            return
        directory = path.with_suffix(_HISTORY)
        directory.mkdir(exist_ok=True)
        _replace(directory / f"{entry.version:020}-{_file_name(entry.origin)}.json", entry)
        for old in sorted(directory.glob("*.json"))[:-depth]:
            old.unlink()

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise StoreUnavailable(self.url, f"{error.strerror or error} ({error.filename or self._root})") from error


def _file_name(name: str) -> str:
    encoded = quote(name, safe=" ()+,=@[]{}")
    if encoded.startswith(".") or encoded.endswith(_HISTORY):
        encoded = encoded.replace(".", "%2E")
    if len(encoded) > _LONGEST:
        return f"{encoded[:_KEPT]}~{hashlib.sha256(name.encode()).hexdigest()[:32]}"
    return encoded


def _read(path: Path) -> Entry | None:
    try:
        value: Any = json_value(path.read_bytes())
        raw = value.get("base64")
        data = value["data"].encode() if raw is None else base64.b64decode(raw, validate=True)
        return Entry(
            str(value["system"]),
            str(value["topic"]),
            data,
            whole(value["version"]),
            whole(value["stamp_ns"]),
            str(value.get("origin", "")),
            str(value.get("type", "")),
            str(value.get("form", "")),
        )
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def _replace(path: Path, entry: Entry) -> None:
    temporary = path.with_suffix(".tmp")
    with temporary.open("wb") as file:
        file.write(json.dumps(as_json(entry), indent=1, ensure_ascii=False).encode())
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)


def _sync_directory(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
