"""Last values as JSON files, one per topic in a directory per system: the layout of the IoRT paper's local file system.

A file is replaced as a whole, so that a reader never sees half of one. Names are percent-encoded where a file system
would not take them.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from ropeway.errors import StoreUnavailable
from ropeway.store.entry import Entry, Key, as_json, whole
from ropeway.wire.frames import json_value

__all__ = ["FilesBackend"]

_HISTORY: Final = ".history"


class FilesBackend:
    """Values under the directory ``path``: ``SYSTEM/TOPIC.json``; earlier ones in ``SYSTEM/TOPIC.history/``."""

    def __init__(self, path: str) -> None:
        self.url = path
        self._root = Path(path).expanduser()

    def open(self) -> None:
        """Make the directory."""
        with self._told():
            self._root.mkdir(parents=True, exist_ok=True)

    def load(self) -> list[Entry]:
        """Every last value; a file that is none is left alone."""
        with self._told():
            found = sorted(self._root.glob("*/*.json"))
            return [entry for path in found if (entry := _read(path)) is not None]

    def write(self, entries: list[Entry], depth: int) -> None:
        """Keep entries, file by file; each is on the disk when this returns."""
        with self._told():
            touched: set[Path] = set()
            if not depth:
                entries = list({entry.key: entry for entry in entries}.values())
            for entry in entries:
                path = self._path(entry.key)
                path.parent.mkdir(exist_ok=True)
                before = _read(path) if path.exists() else None
                if before is not None and before.order > entry.order:
                    self._archive(path, entry, depth)
                    continue
                if before is not None and before.order != entry.order:
                    self._archive(path, before, depth)
                _replace(path, entry)
                touched.add(path.parent)
            for directory in touched:
                _sync_directory(directory)

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
        """The values before the last one, newest first."""
        with self._told():
            found = [_read(path) for path in self._path(key).with_suffix(_HISTORY).glob("*.json")]
        return sorted((e for e in found if e is not None), key=lambda entry: entry.order, reverse=True)

    def close(self) -> None:
        """Nothing is held."""

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
    return encoded.replace(".", "%2E") if encoded.startswith(".") or encoded.endswith(_HISTORY) else encoded


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
