"""Says how coordinate frames are called elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["FrameNames"]


@dataclass(frozen=True, slots=True)
class FrameNames:
    """Says how frames are called elsewhere: without the prefix ``removed`` where they have it, then with ``prefix``.

    Those in ``kept`` stay as they are, and so do the empty name and names that have ``prefix``. A slash at the
    beginning, as in ROS 1, goes.
    """

    prefix: str = ""
    removed: str = ""
    kept: tuple[str, ...] = ("map", "earth")

    def renamed(self, name: str) -> str:
        """Return how a frame is called elsewhere."""
        plain = name.lstrip("/")
        if not plain or plain in self.kept:
            return name
        if self.removed and plain.startswith(self.removed):
            plain = plain[len(self.removed) :] or plain
        if self.prefix and plain not in self.kept and not plain.startswith(self.prefix):
            plain = self.prefix + plain
        return plain
