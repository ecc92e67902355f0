"""The message definitions that each distribution of ROS ships, from the file ``definitions.txt`` beside this module.

The file holds every layout once, under a line ``=== NAME FIRST LAST`` with the first and the last distribution that has
it. ``python -m tests.types.standard`` writes it from what ``rosbags`` knows.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

__all__ = ["DISTROS", "NEWEST", "Block", "read_blocks", "store_table"]

NEWEST: Final = "kilted"
"""The default distribution of a registry: all of Jazzy in the same layouts, and more. Lyrical has dropped some."""

DISTROS: Final = ("noetic", "foxy", "galactic", "humble", "iron", "jazzy", "kilted", "lyrical")
"""The distributions a registry can be named after, from the oldest to the newest."""

_BLOCK: Final = re.compile(r"^=== (?P<name>\S+) (?P<first>\S+) (?P<last>\S+)\n(?P<text>(?:(?!===).*\n)*)", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Block:
    """A layout of an interface, with the places in ``DISTROS`` of the first and the last distribution that has it."""

    name: str
    first: int
    last: int
    text: str


def read_blocks(file: Path) -> list[Block]:
    """Return what a file of definitions holds."""
    return [
        Block(found["name"], DISTROS.index(found["first"]), DISTROS.index(found["last"]), found["text"])
        for found in _BLOCK.finditer(file.read_text("utf-8"))
    ]


@functools.cache
def store_table(distro: str) -> Mapping[str, str]:
    """Return the definitions of ``distro``: for ``parse_msg``, the texts of its messages by their full names.

    Raises ``ValueError`` for a distribution that is not known.
    """
    if distro not in DISTROS:
        raise ValueError(f"{distro!r} is not a known ROS distribution; known are {', '.join(DISTROS)}")
    index = DISTROS.index(distro)
    return {block.name: block.text for block in _blocks() if block.first <= index <= block.last}


@functools.cache
def _blocks() -> list[Block]:
    return read_blocks(Path(__file__).with_name("definitions.txt"))
