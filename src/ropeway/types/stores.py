"""The message definitions that each distribution of ROS ships, from the file ``definitions.txt`` beside this module.

The file holds every layout once, under a line ``=== NAME FIRST LAST`` with the first and the last distribution that has
it. ``python -m tests.types.standard`` writes it from what ``rosbags`` knows.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

__all__ = ["DISTROS", "NEWEST", "store_table"]

NEWEST: Final = "kilted"
"""What a registry has by default: all of Jazzy in the same layouts, and more. Lyrical has dropped some."""

DISTROS: Final = ("noetic", "foxy", "galactic", "humble", "iron", "jazzy", "kilted", "lyrical")
"""The distributions a registry can be named after, from the oldest to the newest."""

_BLOCK: Final = re.compile(r"^=== (?P<name>\S+) (?P<first>\S+) (?P<last>\S+)\n(?P<text>(?:(?!===).*\n)*)", re.MULTILINE)


@functools.cache
def store_table(distro: str) -> Mapping[str, str]:
    """Return the definitions of ``distro``: for ``parse_msg``, the texts of its messages by their full names.

    Raises ``ValueError`` for a distribution that is not known.
    """
    if distro not in DISTROS:
        raise ValueError(f"{distro!r} is not a known ROS distribution; known are {', '.join(DISTROS)}")
    index = DISTROS.index(distro)
    return {
        block["name"]: block["text"]
        for block in _blocks()
        if DISTROS.index(block["first"]) <= index <= DISTROS.index(block["last"])
    }


@functools.cache
def _blocks() -> list[re.Match[str]]:
    return list(_BLOCK.finditer(Path(__file__).with_name("definitions.txt").read_text("utf-8")))
