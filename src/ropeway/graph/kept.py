"""Keeps track of the parts that a program created on a graph and has to close one day."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Final, Generic, Protocol, TypeVar

__all__ = ["Kept"]

_FEW: Final = 32  # are not looked through


class _Part(Protocol):
    @property
    def closed(self) -> bool: ...

    async def close(self) -> None: ...


P = TypeVar("P", bound=_Part)


class Kept(Generic[P]):
    """The parts that are open. Those that were closed are forgotten as others come.

    They are looked through each time that their number has doubled: a thousand parts cost a thousand steps, not a
    million.
    """

    def __init__(self) -> None:
        self._parts: dict[P, None] = {}
        self._look_at = _FEW

    def add(self, part: P) -> None:
        """Keep another part."""
        if len(self._parts) >= self._look_at:
            self._parts = dict.fromkeys(self)
            self._look_at = max(_FEW, 2 * len(self._parts))
        self._parts[part] = None

    def discard(self, part: P) -> None:
        """Forget one now, for parts that tell when they have closed."""
        self._parts.pop(part, None)

    def __contains__(self, part: P) -> bool:
        return part in self._parts and not part.closed

    def __iter__(self) -> Iterator[P]:
        return (part for part in self._parts if not part.closed)

    async def close(self) -> None:
        """Close them all, beside each other."""
        await asyncio.gather(*(part.close() for part in self))
        self._parts.clear()
