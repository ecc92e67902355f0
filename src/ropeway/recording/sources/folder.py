"""Directories of rosbag2: one or more files, played as one recording."""

from __future__ import annotations

import heapq
import tempfile
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import yaml

from ropeway.recording.sources.source import RecordedChannel, Recording
from ropeway.recording.sources.unpacking import Unpacker

if TYPE_CHECKING:
    from typing_extensions import Self


__all__ = ["FolderSource"]

_KINDS: Final = (".mcap", ".db3")
_ID_BITS: Final = 48  # ids of one file are below; the number of the file stands above


class FolderSource:
    """The files that ``metadata.yaml`` names, or all there are where it is missing.

    What the files say of their topics counts; metadata that disagrees is noted.
    """

    def __init__(self, path: Path, open_file: Callable[[Path], AbstractContextManager[Recording]]) -> None:
        self._path, self._open_file = path, open_file
        self._stack = ExitStack()
        self._sources: list[Recording] = []
        self._unpacker = Unpacker()
        self._packed_messages = False
        self.channels: list[RecordedChannel] = []
        self.start_ns = self.end_ns = 0
        self.notes: list[str] = []

    def __enter__(self) -> Self:
        with self._stack:
            about = self._metadata()
            mode = str(about.get("compression_mode") or "").upper()
            if mode not in ("", "NONE", "FILE", "MESSAGE"):
                raise ValueError(f"metadata.yaml: compression by {mode.lower()} is not known")
            for name in self._names(about):
                self._enter(self._path / name)
            self._packed_messages = mode == "MESSAGE"
            self._agree(about)
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield the messages of these channels, of all files in the order of time."""
        chosen: dict[int, list[int]] = {}
        for id in ids:
            chosen.setdefault(id >> _ID_BITS, []).append(id & ((1 << _ID_BITS) - 1))
        streams = [self._numbered(number, inner) for number, inner in chosen.items()]
        for id, time_ns, raw in heapq.merge(*streams, key=lambda message: message[1]):
            yield id, time_ns, self._unpacker.message(raw) if self._packed_messages else raw

    def _numbered(self, number: int, ids: list[int]) -> Iterator[tuple[int, int, bytes]]:
        for id, time_ns, raw in self._sources[number].messages(ids):
            yield number << _ID_BITS | id, time_ns, raw

    def _metadata(self) -> dict[str, Any]:
        file = self._path / "metadata.yaml"
        if not file.exists():
            self.notes.append("it has no metadata.yaml; all files in it are played")
            return {}
        try:
            found = yaml.safe_load(file.read_text(encoding="utf-8", errors="replace"))
        except (yaml.YAMLError, ValueError, RecursionError):  # damaged, or cut short
            found = None
        about = found.get("rosbag2_bagfile_information") if isinstance(found, dict) else None
        if not isinstance(about, dict):
            self.notes.append("metadata.yaml is not from rosbag2; all files next to it are played")
            return {}
        return about

    def _names(self, about: dict[str, Any]) -> list[str]:
        """Return the files to play, in order."""
        here = sorted(file.name for file in self._path.iterdir() if file.name.removesuffix(".zstd").endswith(_KINDS))
        listed = about.get("relative_file_paths")
        if not isinstance(listed, list):
            if not here:
                raise ValueError(
                    "this directory has no metadata.yaml and no .mcap or .db3 file, so it is not a recording"
                )
            return here
        names: list[str] = []
        for name in map(str, listed):
            found = next((one for one in (name, Path(name).name) if (self._path / one).is_file()), None)
            if found is None:
                self.notes.append(f"metadata.yaml names {name}, which is not there")
            else:
                names.append(found)
        left = [name for name in here if name not in names and name.removesuffix(".zstd") not in names]
        if not names:
            if not left:
                raise ValueError("none of the files that metadata.yaml names is there")
            self.notes.append(f"{', '.join(left)}, which metadata.yaml does not name, is played instead")
            return left
        for name in left:
            if f"{name}.zstd" not in names:
                self.notes.append(f"{name} is not named in metadata.yaml and not played")
        return names

    def _enter(self, file: Path) -> None:
        if file.suffix == ".zstd":
            file = self._unpacked(file)
        source = self._stack.enter_context(self._open_file(file))
        if any(channel.count for channel in source.channels):
            started = any(channel.count for channel in self.channels)
            self.start_ns = min(self.start_ns, source.start_ns) if started else source.start_ns
            self.end_ns = max(self.end_ns, source.end_ns)
        number = len(self._sources)
        self._sources.append(source)
        self.channels += [replace(channel, id=number << _ID_BITS | channel.id) for channel in source.channels]
        self.notes += [f"{file.name}: {note}" for note in source.notes]

    def _unpacked(self, file: Path) -> Path:
        """Decompress a file that was compressed as a whole, into a directory that is removed with the recording."""
        directory = self._stack.enter_context(tempfile.TemporaryDirectory(prefix="ropeway-bag-"))
        target = Path(directory, file.name.removesuffix(".zstd"))
        self._unpacker.file(file, target)
        return target

    def _agree(self, about: dict[str, Any]) -> None:
        """Note where the metadata says otherwise than the files."""
        said = about.get("message_count")
        found = sum(channel.count for channel in self.channels)
        if isinstance(said, int) and said != found:
            self.notes.append(f"metadata.yaml tells of {said} messages, the files have {found}")
