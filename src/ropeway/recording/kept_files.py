"""Bounds what recordings take on the disk: the oldest files of a recorder go first."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import NamedTuple

__all__ = ["KeptFile", "KeptFiles"]

log = logging.getLogger("ropeway.record")


class KeptFile(NamedTuple):
    """A file of a recorder, and when it was last written."""

    path: Path
    size_bytes: int
    changed_s: float


class KeptFiles:
    """The MCAP files in the directory of a recorder, of ``most_bytes`` in all. All methods block."""

    def __init__(self, directory: Path, most_bytes: int) -> None:
        self._directory, self._most = directory, most_bytes
        self.removed = 0

    def listed(self) -> list[KeptFile]:
        """Return the files that are there, the oldest first."""
        found = []
        for path in self._directory.glob("*.mcap") if self._directory.is_dir() else ():
            try:
                about = path.stat()
            except OSError:  # removed by somebody else meanwhile
                continue
            found.append(KeptFile(path, about.st_size, about.st_mtime))
        return sorted(found, key=lambda one: (one.changed_s, one.path))

    def make_room(self, coming_bytes: int) -> None:
        """Remove the oldest files until so many bytes fit. Raises ``OSError`` where one cannot be removed."""
        files = self.listed()
        total = sum(one.size_bytes for one in files) + coming_bytes
        for one in files:
            if total <= self._most:
                return
            one.path.unlink(missing_ok=True)
            log.info("%s is removed, as the recordings would take more than %d bytes", one.path, self._most)
            total -= one.size_bytes
            self.removed += 1
