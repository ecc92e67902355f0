"""Converts messages between the CDR of their ROS 2 type and the bytes that ROS 1 sends."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

from ropeway.errors import DecodeError, ValueMismatch
from ropeway.types.codec import MessageCodec
from ropeway.types.definition import HEADER, TIMES, Definition, FieldType
from ropeway.types.layout import Planner
from ropeway.types.reader import Reader, make_reader
from ropeway.types.values import Short
from ropeway.types.writer import FAILURES, Writer, make_writer

__all__ = ["Converter", "names_between", "renamed"]

Definitions = Callable[..., Definition]
Names = Mapping[str, tuple[str, "Names | None"]]
"""Field of the one side to the field of the other, and the same for the message that stands in it."""


class Converter:
    """Turns CDR of one type into ROS 1's bytes and back.

    Where the fields of both definitions are the same but for the spelling of their names, the bytes go straight
    through the codec. Else values go by name: fields that the other side does not have are left out, those that only
    it has get their default. ``alike`` tells which. ``stamped`` tells that the message begins with a header, whose
    first 4 bytes are ``seq`` in ROS 1.
    """

    def __init__(self, codec: MessageCodec, ros2: Definitions, ros1_type: str, ros1: Definitions) -> None:
        self.type = codec.type
        self._codec = codec
        self._ros1_type = ros1_type
        self._ros1 = ros1
        self._ros2 = ros2
        first = ros1(ros1_type).wire_fields[:1]
        self.stamped = bool(first) and first[0].type == FieldType(HEADER)
        self.alike = _alike(codec.type, ros2, ros1_type, ros1)
        self._functions: tuple[Reader, Writer] | None = None
        self._there: Names = {}
        self._back: Names = {}

    def to_ros1(self, cdr: bytes) -> bytes:
        """Convert the message to the bytes of ROS 1. Raises ``DecodeError``."""
        if self.alike:
            return self._codec.ros1(cdr)
        message = renamed(self._codec.decode(cdr), self._names()[0])
        pieces: list[bytes] = []
        try:
            self._made()[1](message, pieces, 0)
        except FAILURES as error:
            raise DecodeError(self.type, "CDR", f"it does not fit ROS 1's {self._ros1_type}: {error}") from None
        return b"".join(pieces)

    def from_ros1(self, raw: bytes) -> bytes:
        """Convert bytes of ROS 1 to CDR. Raises ``DecodeError``."""
        if self.alike:
            return self._codec.from_ros1(raw)
        try:
            value, end = self._made()[0](raw, 0, len(raw))
        except (Short, struct.error, ValueError) as error:
            raise DecodeError(self._ros1_type, "ROS 1", str(error) or "the bytes end too early") from None
        if end != len(raw):
            raise DecodeError(self._ros1_type, "ROS 1", f"{len(raw) - end} bytes are left over")
        try:
            return self._codec.encode(renamed(value, self._names()[1]))
        except ValueMismatch as error:
            raise DecodeError(self.type, "ROS 1", error.reason) from None

    def _made(self) -> tuple[Reader, Writer]:
        if self._functions is None:
            plan = Planner(self._ros1, "ros1").plan(self._ros1_type)
            self._functions = make_reader(plan, "object"), make_writer(plan)
            self._there = names_between(self.type, self._ros2, self._ros1_type, self._ros1)
            self._back = names_between(self._ros1_type, self._ros1, self.type, self._ros2)
        return self._functions

    def _names(self) -> tuple[Names, Names]:
        self._made()
        return self._there, self._back


def _key(name: str) -> str:
    return name.replace("_", "").casefold()


def _plain(type: FieldType) -> FieldType:
    """Reduce a field's type to what determines its bytes."""
    base = {"char": "uint8", "byte": "uint8"}.get(type.base, type.base)
    return FieldType(base, 0, type.kind, type.size if type.kind == "array" else 0)


def _alike(here: str, mine: Definitions, there: str, theirs: Definitions) -> bool:
    """Return whether both have the same fields at all depths, apart from the spelling of their names."""
    if here == there and here in (*TIMES, HEADER):
        return True
    ours, others = mine(here).wire_fields, theirs(there).wire_fields
    if len(ours) != len(others):
        return False
    for a, b in zip(ours, others, strict=True):
        if _key(a.name) != _key(b.name):
            return False
        if a.type.is_message and b.type.is_message:
            shape = (a.type.kind, _plain(a.type).size) == (b.type.kind, _plain(b.type).size)
            if not shape or not _alike(a.type.base, mine, b.type.base, theirs):
                return False
        elif _plain(a.type) != _plain(b.type):
            return False
    return True


def names_between(here: str, mine: Definitions, there: str, theirs: Definitions) -> Names:
    """Return the fields of ``here`` that ``there`` has, too, at all depths."""
    if here == there and here in (*TIMES, HEADER):
        return {field.name: (field.name, None) for field in mine(here).wire_fields}
    others = {_key(field.name): field for field in theirs(there).wire_fields}
    names: dict[str, tuple[str, Names | None]] = {}
    for field in mine(here).wire_fields:
        other = others.get(_key(field.name))
        if other is None or field.type.is_message != other.type.is_message:
            continue
        inner: Names | None = None
        if field.type.is_message:
            if field.type.base in TIMES or other.type.base in TIMES:
                if field.type.base != other.type.base:
                    continue
            else:
                inner = names_between(field.type.base, mine, other.type.base, theirs)
        names[field.name] = (other.name, inner)
    return names


def renamed(value: Any, names: Names) -> dict[str, Any]:
    """Return the fields that the other side has, too, under the names that it uses for them."""
    out: dict[str, Any] = {}
    for name, (other, inner) in names.items():
        if name not in value:
            continue
        found = value[name]
        if inner is None:
            out[other] = found
        elif isinstance(found, list):
            out[other] = [renamed(item, inner) for item in found]
        else:
            out[other] = renamed(found, inner)
    return out
