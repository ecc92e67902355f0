"""The ``TypeDef`` objects with which rosapi describes a message to a program that has no definitions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

from ropeway.errors import InvalidDefinition
from ropeway.types.definition import PRIMITIVES, TIMES, Definition, Field, FieldType, canonical_name, short_name
from ropeway.types.interfaces import concatenated

__all__ = ["IDL_NAMES", "full_text_of", "typedefs"]

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


def full_text_of(name: str, parts: Sequence[object]) -> str:
    """Return the concatenated definition of ``name``, given the ``TypeDef`` objects of each of its parts.

    A message has one part, a service two, an action three; the first object of a part is the part itself. Constants and
    bounds are not told. Raises ``InvalidDefinition``.
    """
    main: list[str] = []
    below: dict[str, str] = {}
    needed: set[str] = set()
    try:
        for objects in parts:
            told = [(canonical_name(each["type"]), _told_fields(each)) for each in objects]  # type: ignore[attr-defined]
            texts = [(each, "".join(f"{type.spelled()} {field}\n" for field, type in fields)) for each, fields in told]
            needed.update(type.base for _, fields in told for _, type in fields if type.is_message)
            main.append(texts[0][1])
            below.update(texts[1:])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InvalidDefinition(name, f"it is told in a way that cannot be read: {error!r}") from None
    if missing := needed.difference(below, TIMES):
        raise InvalidDefinition(name, f"nobody tells what {min(missing)} is, of which it is made")
    return concatenated("---\n".join(main), ((each, text) for each, text in below.items() if each != name))


def _told_fields(told: dict[str, Any]) -> list[tuple[str, FieldType]]:
    columns = (told["fieldnames"], told["fieldtypes"], told["fieldarraylen"])
    return [(field.removeprefix("_"), _told_type(type, length)) for field, type, length in zip(*columns, strict=True)]


def _told_type(spelled: str, length: int) -> FieldType:
    base = _BASES.get(spelled, spelled)
    kind = "scalar" if length < 0 else "array" if length else "sequence"
    return FieldType(base if base in PRIMITIVES else canonical_name(base), kind=kind, size=max(length, 0))


_BASES: Final = {
    **{idl: name for name, idl in IDL_NAMES.items() if name != "char"},
    **{time.rpartition("/")[2].lower(): time for time in TIMES},  # as ROS 1 spells them
}


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
