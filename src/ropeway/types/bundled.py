"""The interfaces of packages that many robots have and that are no part of a distribution's core: nav2, MoveIt, PX4.

Each file in ``packages/`` holds one package, with its source and licence; it is read when a type of it is first asked
for. The layouts are those of each distribution; ``python -m tests.types.packages`` writes them from the sources. What
a workspace, a file or a graph tells of such a type goes before what stands here.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from ropeway.types.interfaces import owner_of
from ropeway.types.stores import DISTROS, Block, read_blocks

__all__ = ["FOLDER", "Bundled", "bundled_packages", "has_changed"]

FOLDER: Final = Path(__file__).with_name("packages")


class Bundled(Mapping[str, str]):
    """The texts of one distribution's interfaces by their full names; ``changed`` leaves out what never changed."""

    def __init__(self, distro: str, *, changed: bool = False) -> None:
        self._index, self._changed = DISTROS.index(distro), changed

    def __getitem__(self, name: str) -> str:
        package = name.partition("/")[0]
        for block in _package(package).get(name, ()) if package in bundled_packages() else ():
            if block.first <= self._index <= block.last and (not self._changed or has_changed(name)):
                return block.text
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return (name for package in bundled_packages() for name in _package(package) if name in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)


@functools.cache
def bundled_packages() -> frozenset[str]:
    """Return the names of the packages."""
    return frozenset(file.stem for file in FOLDER.glob("*.txt"))


def has_changed(name: str) -> bool:
    """Return whether distributions of ROS 2 give an interface, or the one that a part belongs to, several layouts."""
    package = name.partition("/")[0]
    if package not in bundled_packages():
        return False
    return sum(block.last > 0 for block in _package(package).get(owner_of(name), ())) > 1


@functools.cache
def _package(package: str) -> Mapping[str, tuple[Block, ...]]:
    found: dict[str, tuple[Block, ...]] = {}
    for block in read_blocks(FOLDER / f"{package}.txt"):
        found[block.name] = (*found.get(block.name, ()), block)
    return found
