"""Writes ``src/ropeway/types/definitions.txt`` from the type stores of rosbags: ``python -m tests.types.standard``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

import ropeway.types.stores as stores
from ropeway.types.definition import Constant, Definition, Field, FieldType

__all__ = ["FILE", "STORES", "from_rosbags", "written"]

FILE: Final = Path(stores.__file__).with_name("definitions.txt")
STORES: Final = {distro: Stores[f"ROS{1 if distro == 'noetic' else 2}_{distro.upper()}"] for distro in stores.DISTROS}
_HEAD: Final = """\
# The messages of every distribution: name, first and last distribution with this layout, fields and constants.
# Written by `python -m tests.types.standard`; what rosbags leaves out stands in standard.py.

"""
_DEFAULTS: Final[dict[str, dict[str, object]]] = {
    "geometry_msgs/msg/Quaternion": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    "sensor_msgs/msg/NavSatStatus": {"status": -2},
}
"""Default values that the stores do not tell (those that equal zero left out)."""
_EMPTY: Final = "structure_needs_at_least_one_member"  # what IDL has in a message without fields


def written() -> str:
    """Return what the file has to hold."""
    spans: dict[tuple[str, str], list[str]] = {}
    for distro, store in STORES.items():
        for name, definition in from_rosbags(get_typestore(store).fielddefs).items():
            spans.setdefault((name, definition.text()), []).append(distro)
    pieces = [_HEAD]
    for (name, text), distros in sorted(spans.items(), key=lambda item: (item[0][0], stores.DISTROS.index(item[1][0]))):
        first, last = (stores.DISTROS.index(distro) for distro in (distros[0], distros[-1]))
        assert list(stores.DISTROS[first : last + 1]) == distros, f"{name} has changed back and forth"
        pieces.append(f"=== {name} {distros[0]} {distros[-1]}\n{text}")
    return "".join(pieces)


def from_rosbags(table: Mapping[str, Any]) -> dict[str, Definition]:
    """Return the definitions in a table of rosbags: names with constants and fields."""
    return {
        name: Definition(
            name,
            tuple(
                Field(field, _type(described), _DEFAULTS.get(name, {}).get(field))
                for field, described in fields
                if field != _EMPTY
            ),
            tuple(Constant(constant, type, value, str(value)) for constant, type, value in constants),
        )
        for name, (constants, fields) in table.items()
    }


def _type(described: Any) -> FieldType:
    node, rest = described
    if node == Nodetype.NAME:
        return FieldType(rest)
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        inner = _type(rest[0])
        return FieldType(inner.base, inner.bound, "array" if node == Nodetype.ARRAY else "sequence", rest[1])
    base, bound = rest
    return FieldType(base, bound)


if __name__ == "__main__":
    FILE.write_text(written(), "utf-8")
