"""Describes message types: their names, fields and constants, and the text that they are written in.

A ``Definition`` is immutable and knows nothing of other definitions; ``TypeRegistry`` joins them by name. Names
are always in full, ``pkg/msg/Name``; the parts of a service or an action have names of their own, as in ROS 2
(``pkg/srv/Name_Request``, ``pkg/action/Name_Feedback``).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from ropeway.errors import InvalidDefinition, InvalidTypeName
from ropeway.limits import TYPE_NAME_CHARACTERS

__all__ = [
    "FILLER",
    "HEADER",
    "KINDS",
    "PRIMITIVES",
    "ROS1_HEADER",
    "ROS1_TIMES",
    "TIMES",
    "Constant",
    "Definition",
    "Field",
    "FieldType",
    "canonical_name",
    "short_name",
]

KINDS: Final = ("msg", "srv", "action")
FILLER: Final = "structure_needs_at_least_one_member"
"""The field, an uint8, that IDL and type descriptions give a message without fields."""

HEADER: Final = "std_msgs/msg/Header"
TIMES: Final = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")

ROS1_TIMES: Final = ("ros1/msg/Time", "ros1/msg/Duration")
ROS1_HEADER: Final = "ros1/msg/Header"
"""Names that no package has, for the values of ROS 1 whose fields are others than those of ROS 2."""

PRIMITIVES: Final = {
    "bool": 1,
    "byte": 1,
    "char": 1,
    "int8": 1,
    "uint8": 1,
    "int16": 2,
    "uint16": 2,
    "int32": 4,
    "uint32": 4,
    "int64": 8,
    "uint64": 8,
    "float32": 4,
    "float64": 8,
    "string": 0,
    "wstring": 0,
}
"""The primitive types of a ``.msg`` file and their sizes in bytes; 0 where the size varies."""


_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")


def canonical_name(name: str, kind: str = "msg") -> str:
    """Return the full name ``pkg/msg/Name`` of a type.

    Takes ``pkg/Name``, ``pkg/msg/Name`` and ``pkg.msg.Name``; superfluous slashes do not matter. ``kind`` is the
    middle part where the name has none. Raises ``InvalidTypeName``.
    """
    if not isinstance(name, str) or len(name) > TYPE_NAME_CHARACTERS:
        raise InvalidTypeName(name)
    return _canonical(name, kind)


@lru_cache(maxsize=4096)
def _canonical(name: str, kind: str) -> str:
    parts = [part for part in (name if "/" in name else name.replace(".", "/")).split("/") if part]
    if len(parts) == 2:
        parts.insert(1, kind)
    if len(parts) != 3 or parts[1] not in KINDS or not _NAME.match(parts[0]) or not _NAME.match(parts[2]):
        raise InvalidTypeName(name)
    return "/".join(parts)


def short_name(name: str) -> str:
    """Return the two-part form of a full name: ``std_msgs/String`` for ``std_msgs/msg/String``."""
    package, _, base = name.split("/")
    return f"{package}/{base}"


@dataclass(frozen=True, slots=True)
class FieldType:
    """The type of one field.

    ``base`` is one of ``PRIMITIVES`` or the full name of a message. ``bound`` is the longest string in bytes (code
    units of a wstring), 0 meaning unbounded. ``kind`` is ``scalar``, ``array`` or ``sequence``; ``size`` is the
    length of an array or the longest sequence, 0 meaning unbounded.
    """

    base: str
    bound: int = 0
    kind: str = "scalar"
    size: int = 0

    @property
    def is_message(self) -> bool:
        """Whether the base is another message."""
        return "/" in self.base

    def spelled(self, base: str | None = None) -> str:
        """Spell the type as a ``.msg`` file does, ``string<=5[<=3]``; ``base`` replaces the name of the base."""
        text = base or (short_name(self.base) if "/msg/" in self.base else self.base)
        if self.bound:
            text += f"<={self.bound}"
        if self.kind == "array":
            return f"{text}[{self.size}]"
        if self.kind == "sequence":
            return f"{text}[<={self.size}]" if self.size else f"{text}[]"
        return text


@dataclass(frozen=True, slots=True)
class Field:
    """A field. ``default`` is a Python value (a list for arrays) or ``None`` for the type's zero."""

    name: str
    type: FieldType
    default: object = None


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant. ``text`` is the value as it was written."""

    name: str
    type: str
    value: bool | int | float | str
    text: str


@dataclass(frozen=True, slots=True)
class Definition:
    """A message: its fields and constants, and the text it was read from (``""`` where there was none)."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[Constant, ...] = ()
    source: str = ""

    @property
    def wire_fields(self) -> tuple[Field, ...]:
        """The fields that ROS 2 sends: all, but for the ``seq`` that a ROS 1 header begins with."""
        if self.name == HEADER and self.fields and self.fields[0].name == "seq":
            return self.fields[1:]
        return self.fields

    def same_layout(self, other: Definition) -> bool:
        """Return whether messages of both are the same bytes with the same field names, whatever their bounds."""
        mine, theirs = self.wire_fields, other.wire_fields
        return len(mine) == len(theirs) and all(
            a.name == b.name and _plain(a.type) == _plain(b.type) for a, b in zip(mine, theirs, strict=True)
        )

    def text(self) -> str:
        """Return the definition as a ``.msg`` file: as it was read, or written from fields and constants."""
        if self.source:
            return self.source
        lines = [f"{c.type} {c.name}={c.text}" for c in self.constants]
        for field in self.fields:
            default = "" if field.default is None else f" {_literal(field.default)}"
            lines.append(f"{field.type.spelled()} {field.name}{default}")
        return "".join(f"{line}\n" for line in lines)

    def check(self) -> None:
        """Raise ``InvalidDefinition`` for what no parser notices: a field or constant named twice."""
        seen: set[str] = set()
        for name in [f.name for f in self.fields] + [c.name for c in self.constants]:
            if name in seen:
                raise InvalidDefinition(self.name, f"{name} is defined twice")
            seen.add(name)


def _plain(type: FieldType) -> FieldType:
    """Return the type without what changes no byte: bounds, and the name ``char`` for ``uint8``."""
    base = "uint8" if type.base == "char" else type.base
    return FieldType(base, kind=type.kind, size=type.size if type.kind == "array" else 0)


def _literal(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, list):
        return "[" + ", ".join(_literal(item) for item in value) + "]"
    return repr(value)
