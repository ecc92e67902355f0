"""Implements what the parts of a group share: each is a part on every member, and members come and go."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Generic, TypeVar

from ropeway.group.chooser import Chooser

__all__ = ["GroupPart"]

P = TypeVar("P")


class GroupPart(Generic[P]):
    """A part of a group, as a part on each member, by the names of the members."""

    def __init__(self, group: Chooser, parts: Mapping[str, P]) -> None:
        self._group = group
        self._parts: dict[str, P] = dict(parts)

    @property
    def on(self) -> frozenset[str]:
        """The members that it is on."""
        return frozenset(self._parts)

    def add(self, name: str, part: P) -> None:
        """Take the part on a member that has come."""
        self._parts[name] = part

    async def remove(self, name: str) -> None:
        """Close the part on a member that has left."""
        part: Any = self._parts.pop(name, None)
        if part is not None:
            await part.close()

    async def close(self) -> None:
        """Close the part on every member."""
        for name in list(self._parts):
            await self.remove(name)
        self._group.closed(self)
