"""The ``TypeDef`` objects with which rosapi describes a message to a program that has no definitions."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from ropeway.types.definition import TIMES, Definition, Field, short_name

__all__ = ["IDL_NAMES", "typedefs"]

IDL_NAMES: Final = {"bool": "boolean", "byte": "octet", "char": "uint8", "float32": "float", "float64": "double"}
"""How rosbridge spells the primitive types that IDL names otherwise."""


def typedefs(
    names: Iterable[str], definition: Callable[[str], Definition], *, ros1: bool = False
) -> list[dict[str, Any]]:
    """Return one ``TypeDef`` for each of ``names``, in that order, with two-part names as clients expect them.

    ``ros1`` spells fields as ROS 1 does: a header has its ``seq``, and primitive types keep the names of a .msg.
    """
    found = []
    for name in names:
        known = definition(name)
        fields = known.fields if ros1 else known.wire_fields
        found.append(
            {
                "type": short_name(name),
                "fieldnames": [field.name for field in fields],
                "fieldtypes": [_spelled(field, ros1) for field in fields],
                "fieldarraylen": [_length(field) for field in fields],
                "examples": [_example(field) for field in fields],
                "constnames": [constant.name for constant in known.constants],
                "constvalues": [_text(constant.type, constant.value) for constant in known.constants],
            }
        )
    return found


def _spelled(field: Field, ros1: bool) -> str:
    base = field.type.base
    if ros1:
        return base.rpartition("/")[2].lower() if base in TIMES else short_name(base) if field.type.is_message else base
    return short_name(base) if field.type.is_message else IDL_NAMES.get(base, base)


def _length(field: Field) -> int:
    if field.type.kind == "scalar":
        return -1
    return field.type.size if field.type.kind == "array" else 0


def _example(field: Field) -> str:
    if field.type.kind != "scalar":
        return "[]"
    if field.type.is_message:
        return "{}"
    if field.default is not None:
        return _text(field.type.base, field.default)
    if field.type.base in ("string", "wstring"):
        return ""
    return {"bool": "False", "float32": "0.0", "float64": "0.0", "byte": "b'\\x00'"}.get(field.type.base, "0")


def _text(type: str, value: object) -> str:
    """Write a value as Python does where rosbridge runs: a byte is ``bytes`` there."""
    return str(bytes([value])) if type == "byte" and isinstance(value, int) else str(value)
