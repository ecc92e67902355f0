"""ropeway.recording.kept_files: a bound on what recordings take."""

from __future__ import annotations

import os
from pathlib import Path

from ropeway.recording.files import McapFiles
from ropeway.recording.kept_files import KeptFiles
from tests.recording.test_files import channel, messages


def test_the_oldest_go_first(tmp_path: Path) -> None:
    """Before each new file the oldest recordings are removed, as far as it needs the room; nothing else is."""
    (tmp_path / "notes.txt").write_bytes(bytes(10_000))
    for number in range(5):
        path = tmp_path / f"run_{9 - number}.mcap"
        path.write_bytes(bytes(1_000))
        os.utime(path, (number, number))
    kept = KeptFiles(tmp_path, 4_000)
    kept.make_room(500)
    assert [one.path.name for one in kept.listed()] == ["run_7.mcap", "run_6.mcap", "run_5.mcap"]
    assert kept.removed == 2
    assert (tmp_path / "notes.txt").exists()


def test_a_split_recording_stays_within_its_bound(tmp_path: Path) -> None:
    """However much is recorded, the files take no more than the bound, and the newest messages are there."""
    kept = KeptFiles(tmp_path, 10_000)
    files = McapFiles(tmp_path / "run", split_bytes=2_000, kept=kept)
    files.write(messages(channel(), 2_000))
    files.close()
    assert sum(one.size_bytes for one in kept.listed()) <= 12_000  # the index of the last file comes on top
    assert kept.removed > 10
    assert files.paths[-1].exists()


def test_nothing_there(tmp_path: Path) -> None:
    """A directory that does not exist yet has no files."""
    assert KeptFiles(tmp_path / "none", 1).listed() == []
