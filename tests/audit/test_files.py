"""The files of the audit log are appended, rotated, bounded, and survive whatever happens to the process."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from ropeway.audit.files import AuditFiles

DAY_S = 86_400.0


class Clock:
    """A clock that stands."""

    now = 1e9

    def __call__(self) -> float:
        return self.now


def _files(path: Path, clock: Clock | None = None, **limits: Any) -> AuditFiles:
    given = {"file_bytes": 1 << 20, "files": 3, "file_days": 7.0, "keep_days": 30.0, **limits}
    return AuditFiles(path, clock=clock or Clock(), **given)


def _entry(number: int) -> dict[str, Any]:
    return {"number": number, "time": 1e9, "kind": "change", "name": "x" * 100}


def _numbers(files: AuditFiles) -> list[int]:
    return [line.number for line in files.backwards()]


def test_entries_are_read_backwards(tmp_path: Path) -> None:
    """Entries come back, the newest first, over all files, also those of an earlier process."""
    path = tmp_path / "log" / "audit"
    files = _files(path, file_bytes=4096, files=100)
    assert files.open() == 0
    for number in range(1, 201):
        files.append([_entry(number)])
    files.close()
    again = _files(path, file_bytes=4096, files=100)
    assert again.open() == 200
    assert _numbers(again) == list(range(200, 0, -1))
    assert path.stat().st_mode & 0o077 == 0
    assert path.parent.stat().st_mode & 0o077 == 0
    again.close()


def test_files_are_bounded_in_size_and_number(tmp_path: Path) -> None:
    """However much is written, there are so many files of such a size, and the newest entries are in them."""
    path = tmp_path / "audit"
    files = _files(path, file_bytes=4096, files=3)
    for number in range(1, 1001):
        files.append([_entry(number)])
    logs = [found for found in tmp_path.iterdir() if found.suffix != ".lock"]
    assert sorted(found.name for found in logs) == ["audit", "audit.1", "audit.2"]
    assert all(found.stat().st_size <= 4096 for found in logs)
    numbers = _numbers(files)
    assert numbers[0] == 1000
    assert numbers == list(range(1000, 1000 - len(numbers), -1))
    files.close()


def test_files_are_rotated_and_removed_by_age(tmp_path: Path) -> None:
    """A file is full some days after its first entry, and is gone some days after its last."""
    path, clock = tmp_path / "audit", Clock()
    files = _files(path, clock)
    files.append([_entry(1)])
    clock.now += 8 * DAY_S
    files.append([_entry(2)])
    assert (tmp_path / "audit.1").exists()
    os.utime(tmp_path / "audit.1", (clock.now - 31 * DAY_S,) * 2)
    files.close()
    files = _files(path, clock)
    files.open()
    assert _numbers(files) == [2]
    files.close()


def test_a_torn_line_costs_no_other(tmp_path: Path) -> None:
    """A process that was killed in the middle of a line leaves a log that goes on."""
    path = tmp_path / "audit"
    files = _files(path)
    files.append([_entry(1)])
    files.close()
    with path.open("ab") as torn:
        torn.write(b'{"number":2,"ki')
    files = _files(path)
    assert files.open() == 2
    files.append([_entry(3)])
    assert [line.number for line in files.backwards() if line.entry is not None] == [3, 1]
    files.close()


def test_two_gateways_do_not_share_a_log(tmp_path: Path) -> None:
    """A log that another process writes is refused with what to do, and is there once that one has ended."""
    first, second = _files(tmp_path / "audit"), _files(tmp_path / "audit")
    first.open()
    with pytest.raises(OSError, match="another gateway writes it"):
        second.open()
    first.close()
    second.open()
    second.close()


@pytest.mark.netns
def test_a_full_disk_leaves_no_half_entry(tmp_path: Path) -> None:
    """What does not fit is refused as a whole; once there is room again, the log goes on."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(tmp_path)], check=True)
    try:
        files = _files(tmp_path / "audit")
        files.append([_entry(1)])
        ballast = tmp_path / "ballast"
        with pytest.raises(OSError, match="No space left"), ballast.open("wb", buffering=0) as full:
            while True:
                full.write(bytes(4096))
        with pytest.raises(OSError, match="No space left"):
            files.append([_entry(number) for number in range(2, 100)])
        assert _numbers(files) == [1]
        ballast.unlink()
        files.append([_entry(2)])
        assert _numbers(files) == [2, 1]
        files.close()
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)
