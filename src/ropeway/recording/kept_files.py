"""Bounds what recordings take on the disk: the oldest files of a recorder go first."""

from __future__ import annotations

import logging
from pathlib import Path

__all__ = ["KeptFiles"]

log = logging.getLogger("ropeway.record")


class KeptFiles:
    """The files in ``directory`` whose names begin with ``prefix``, of ``most_bytes`` in all. All methods block.

    Names have the date and time of their beginning, so that the order of names is that of age.
    """

    def __init__(self, directory: Path, prefix: str, most_bytes: int) -> None:
        self._directory, self._prefix, self._most = directory, prefix, most_bytes
        self.removed = 0

    def sizes(self) -> dict[Path, int]:
        """Return the files that are there, the oldest first, with their sizes."""
        found = {}
        for path in sorted(self._directory.glob(f"{self._prefix}*.mcap")) if self._directory.is_dir() else ():
            try:
                found[path] = path.stat().st_size
            except OSError:  # removed by somebody else meanwhile
                continue
        return found

    def make_room(self, coming_bytes: int) -> None:
        """Remove the oldest files until so many bytes fit. Raises ``OSError`` where one cannot be removed."""
        sizes = self.sizes()
        total = sum(sizes.values()) + coming_bytes
        for path, size in sizes.items():
            if total <= self._most:
                return
            path.unlink(missing_ok=True)
            log.info("%s is removed, as the recordings would take more than %d bytes", path, self._most)
            total -= size
            self.removed += 1
