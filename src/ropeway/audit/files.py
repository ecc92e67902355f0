"""The files of the audit log: a line of JSON for each entry, appended, rotated by size and age, bounded in number.

All methods block, and raise ``OSError`` where a disk is full or may not be written.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO, Final, NamedTuple

import orjson

from ropeway.audit.merging import AuditEntry

__all__ = ["AuditFiles", "AuditLine"]

_DAY_S: Final = 86_400.0
_CHUNK_BYTES: Final = 64 << 10
_LONGEST_LINE_BYTES: Final = 1 << 20
_NUMBER: Final = b'{"number":'
_DIGITS: Final = 20


class AuditLine(NamedTuple):
    """A line of the log; ``entry`` is ``None`` where it was not wanted."""

    number: int
    size_bytes: int
    entry: AuditEntry | None


def _any(_: bytes) -> bool:
    return True


class AuditFiles:
    """The file ``path``, and ``path.1`` (the newest that is full) up to ``path.<files - 1>``.

    A file is full at ``file_bytes``, or ``file_days`` after its first entry; full ones are kept for ``keep_days``.
    Only one process has the files open at a time.
    """

    def __init__(
        self,
        path: Path,
        *,
        file_bytes: int,
        files: int,
        file_days: float,
        keep_days: float,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self.path = path
        self._file_bytes, self._files = file_bytes, files
        self._file_s, self._keep_s = file_days * _DAY_S, keep_days * _DAY_S
        self._clock = clock
        self._lock = threading.Lock()  # readers find no file that is being renamed
        self._held: int | None = None
        self._file: int | None = None
        self._size = 0
        self._began_s = 0.0

    def open(self) -> int:
        """Open the files; return the number of the last entry, 0 where there is none. Harmless twice."""
        with self._lock:
            if self._file is None:
                self._take_lock()
                self._open_file()
                self._forget_old()
        return self._last_number()

    def append(self, entries: Sequence[AuditEntry]) -> None:
        """Append entries: all of them, or none where it fails."""
        data = b"".join(map(_line, entries))
        with self._lock:
            if self._file is None:
                self._take_lock()
                self._open_file()
            if self._size and (self._size + len(data) > self._file_bytes or self._aged()):
                self._rotate()
            assert self._file is not None
            try:
                _write_all(self._file, data)
                os.fdatasync(self._file)
            except OSError:
                with contextlib.suppress(OSError):
                    os.ftruncate(self._file, self._size)  # half an entry would spoil the next
                raise
            if not self._size:
                self._began_s = self._clock()
            self._size += len(data)

    def backwards(self, wanted: Callable[[bytes], bool] = _any, before: int | None = None) -> Iterator[AuditLine]:
        """See ``AuditSink``."""
        with contextlib.ExitStack() as stack:
            with self._lock:
                opened = [stack.enter_context(file) for file in self._opened()]
            for file in opened:
                if before is not None and (_number(_first_line(file)) or 0) >= before:
                    continue
                for line in _lines_backwards(file):
                    number = _number(line)
                    if number is not None and (before is None or number < before):
                        yield AuditLine(number, len(line) + 1, _read(line) if wanted(line) else None)

    def close(self) -> None:
        """Close the files. Harmless twice."""
        with self._lock:
            for number in (self._file, self._held):
                if number is not None:
                    os.close(number)
            self._file = self._held = None

    def _opened(self) -> Iterator[IO[bytes]]:
        for path in (self.path, *map(self._full, range(1, self._files))):
            try:
                yield path.open("rb")
            except (FileNotFoundError, NotADirectoryError):
                continue

    def _full(self, number: int) -> Path:
        return self.path.with_name(f"{self.path.name}.{number}")

    def _take_lock(self) -> None:
        if self._held is not None:
            return
        self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        lock = os.open(self.path.with_name(f"{self.path.name}.lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(lock)
            if error.errno in (errno.EAGAIN, errno.EACCES):
                raise OSError(
                    error.errno, "another gateway writes it; give this one another gateway.audit.path"
                ) from None
            raise
        self._held = lock

    def _open_file(self) -> None:
        self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)
        self._size = os.fstat(self._file).st_size
        self._began_s = self._clock()
        if not self._size:
            return
        if os.pread(self._file, 1, self._size - 1) != b"\n":  # the process was killed in the middle of a line
            self._size += _write_all(self._file, b"\n")
        with self.path.open("rb") as file:
            first = _read(_first_line(file))
        if first is not None and isinstance(first.get("time"), float | int):
            self._began_s = float(first["time"])

    def _aged(self) -> bool:
        return self._clock() - self._began_s >= self._file_s

    def _rotate(self) -> None:
        assert self._file is not None
        for number in range(self._files - 1, 0, -1):
            source = self.path if number == 1 else self._full(number - 1)
            with contextlib.suppress(FileNotFoundError):
                source.replace(self._full(number))
        if self._files == 1:
            self.path.unlink(missing_ok=True)
        os.close(self._file)
        self._file = None
        self._open_file()
        self._forget_old()

    def _forget_old(self) -> None:
        """Remove full files that are too old, or more than there may be."""
        for path in self.path.parent.glob(f"{self.path.name}.*"):
            number = path.name.removeprefix(f"{self.path.name}.")
            if not number.isdigit():
                continue
            with contextlib.suppress(FileNotFoundError):
                if int(number) >= self._files or self._clock() - path.stat().st_mtime >= self._keep_s:
                    path.unlink()

    def _last_number(self) -> int:
        return next((line.number for line in self.backwards(lambda _: False)), 0)


def _line(entry: AuditEntry) -> bytes:
    return orjson.dumps(entry, option=orjson.OPT_NON_STR_KEYS | orjson.OPT_APPEND_NEWLINE, default=str)


def _first_line(file: IO[bytes]) -> bytes:
    file.seek(0)
    return file.readline(_LONGEST_LINE_BYTES)


def _number(line: bytes) -> int | None:
    """Return the number of an entry, which stands first in its line."""
    if not line.startswith(_NUMBER):
        return None
    digits = line[len(_NUMBER) :].partition(b",")[0]
    return int(digits) if digits.isdigit() and len(digits) < _DIGITS else None


def _read(line: bytes) -> AuditEntry | None:
    try:
        found = json.loads(line)
    except ValueError:  # a line that was torn when the process was killed
        return None
    return found if isinstance(found, dict) else None


def _write_all(file: int, data: bytes) -> int:
    written = 0
    while written < len(data):
        written += os.write(file, data[written:])
    return written


def _lines_backwards(file: IO[bytes]) -> Iterable[bytes]:
    """Yield the lines of a file, the last first; of one that is too long, nothing."""
    end = file.seek(0, os.SEEK_END)
    rest = b""
    while end > 0:
        size = min(_CHUNK_BYTES, end)
        end -= size
        file.seek(end)
        parts = (file.read(size) + rest).split(b"\n")
        rest = parts[0] if len(parts[0]) <= _LONGEST_LINE_BYTES else b""
        yield from (line for line in reversed(parts[1:]) if line)
    if rest:
        yield rest
