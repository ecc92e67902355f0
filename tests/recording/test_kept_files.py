"""ropeway.recording.kept_files: a bound on what recordings take."""

from __future__ import annotations

from pathlib import Path

from ropeway.recording.files import McapFiles
from ropeway.recording.kept_files import KeptFiles
from tests.recording.test_files import channel, messages


def test_the_oldest_go_first(tmp_path: Path) -> None:
    """Before each new file the oldest ones of the recorder are removed, as far as it needs the room; others stay."""
    (tmp_path / "other.mcap").write_bytes(bytes(10_000))
    for number in range(5):
        (tmp_path / f"run_{number}.mcap").write_bytes(bytes(1_000))
    kept = KeptFiles(tmp_path, "run_", 4_000)
    kept.make_room(500)
    assert [path.name for path in kept.sizes()] == ["run_2.mcap", "run_3.mcap", "run_4.mcap"]
    assert kept.removed == 2
    assert (tmp_path / "other.mcap").exists()


def test_a_split_recording_stays_within_its_bound(tmp_path: Path) -> None:
    """However much is recorded, the files take no more than the bound, and the newest messages are there."""
    kept = KeptFiles(tmp_path, "run", 10_000)
    files = McapFiles(tmp_path / "run", split_bytes=2_000, kept=kept)
    files.write(messages(channel(), 2_000))
    files.close()
    assert sum(kept.sizes().values()) <= 12_000  # the index of the last file comes on top
    assert kept.removed > 10
    assert files.paths[-1].exists()


def test_nothing_there(tmp_path: Path) -> None:
    """A directory that does not exist yet has no files."""
    assert KeptFiles(tmp_path / "none", "run", 1).sizes() == {}
