"""Tells what kind of recording a file is, and opens it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Final

from ropeway.recording.sources.folder import FolderSource
from ropeway.recording.sources.mcap import McapSource
from ropeway.recording.sources.ros1 import Ros1Scan, Ros1Source
from ropeway.recording.sources.source import DAMAGED, Recording
from ropeway.recording.sources.sqlite import SqliteSource

__all__ = ["open_recording"]

_MCAP: Final = b"\x89MCAP0\r\n"
_LFS: Final = b"version https://git-lfs.github.com/spec/"
_ANNEX: Final = b"/annex/objects/"
_PACKED: Final = {
    b"\x1f\x8b": "gzip",
    b"PK\x03\x04": "ZIP",
    b"BZh": "bzip2",
    b"\xfd7zXZ": "xz",
    b"\x28\xb5\x2f\xfd": "zstd",
}


def open_recording(path: Path) -> AbstractContextManager[Recording]:
    """Return the recording at ``path``, to be entered. Raises ``ValueError`` for what is none, and ``DAMAGED``."""
    if path.is_dir():
        _refuse_pointer(path / "metadata.yaml")
        return FolderSource(path, _open_file)
    return _open_file(path)


def _open_file(path: Path) -> AbstractContextManager[Recording]:
    _refuse_pointer(path)
    with path.open("rb") as file:
        magic = file.read(16)
    if magic.startswith(_MCAP):
        return McapSource(path)
    if magic.startswith(b"#ROSBAG V"):
        return _bag(path)
    if magic.startswith(b"SQLite format 3"):
        return SqliteSource(path)
    if not magic:
        raise ValueError(f"{path.name} is empty")
    if magic.startswith(b"#ROSRECORD V"):
        raise ValueError(f"{path.name} is a bag of ROS 1 before version 2.0; `rosbag reindex` renews it")
    if (packed := next((name for begin, name in _PACKED.items() if magic.startswith(begin)), None)) is not None:
        raise ValueError(f"{path.name} is packed with {packed}; unpack it first")
    raise ValueError(f"{path.name} is not a recording of a known kind (MCAP, rosbag2 or ROS 1 bag)")


@contextmanager
def _bag(path: Path) -> Iterator[Recording]:
    try:
        source: Ros1Source | Ros1Scan = Ros1Source(path).__enter__()
    except DAMAGED:
        source = Ros1Scan(path).__enter__()
    try:
        yield source
    finally:
        source.__exit__()


def _refuse_pointer(path: Path) -> None:
    """Refuse the pointer that a checkout has in place of a large file, and say what it is."""
    annexed = f"{path.name} is a pointer of git-annex, not the file itself; `git annex get` brings it"
    if path.is_symlink() and not path.exists():
        target = str(path.readlink())
        raise ValueError(annexed if _ANNEX.decode() in target else f"{path.name} leads to {target}, which is not there")
    if not path.is_file():
        return
    with path.open("rb") as file:
        begin = file.read(len(_LFS))
    if begin == _LFS:
        raise ValueError(f"{path.name} is a pointer of Git LFS, not the file itself; `git lfs pull` brings it")
    if begin.startswith(_ANNEX):
        raise ValueError(annexed)
