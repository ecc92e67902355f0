"""Casts values that a person wrote to the types of their fields, as ``ros2`` does with YAML on its command line.

Clients and gateways send values of the right types, and a value of theirs that does not fit is refused. A person types
``{data: 5}`` for a text or ``{data: nan}`` for a number, and means what ``ros2`` makes of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from ropeway.types.definition import HEADER, TIMES, Definition, FieldType

__all__ = ["cast"]

_INTEGERS: Final = frozenset(("byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"))
_TRUTHS: Final = {
    **dict.fromkeys(("true", "yes", "on", "1"), True),
    **dict.fromkeys(("false", "no", "off", "0"), False),
}


def cast(name: str, value: Any, definition: Callable[[str], Definition]) -> Any:
    """Return ``value``, a message of type ``name``, with its parts cast to the types of their fields.

    Numbers and bools become texts and texts numbers, floats lose what follows the point in a field of integers, and
    ``auto`` for a header becomes the time of sending. What cannot be cast stays as it is, for the codec to refuse with
    the name of the field.
    """
    if name == HEADER and value == "auto":
        return {"stamp": "now"}
    if not isinstance(value, Mapping):
        return value
    if name in TIMES:
        return {key: _scalar("int64", part) for key, part in value.items()}
    types = {field.name: field.type for field in definition(name).wire_fields}
    return {key: _field(types[key], part, definition) if key in types else part for key, part in value.items()}


def _field(type: FieldType, value: Any, definition: Callable[[str], Definition]) -> Any:
    if type.kind == "scalar":
        return _element(type.base, value, definition)
    if not isinstance(value, (list, tuple)):
        return value
    if type.base in _INTEGERS:  # as ros2: an array takes no number that it would have to cut
        return [item if _is_cut(item) else _scalar(type.base, item) for item in value]
    return [_element(type.base, item, definition) for item in value]


def _element(base: str, value: Any, definition: Callable[[str], Definition]) -> Any:
    return cast(base, value, definition) if "/" in base else _scalar(base, value)


def _scalar(base: str, value: Any) -> Any:
    if not isinstance(value, (bool, int, float, str)):
        return value
    if base in ("string", "wstring"):
        return str(value)
    if base == "bool":
        return _TRUTHS.get(value.lower(), value) if isinstance(value, str) else bool(value)
    try:
        return _whole(value) if base in _INTEGERS else float(value)
    except (ValueError, OverflowError):  # a text that is no number; NaN and infinity among integers
        return value


def _whole(value: bool | int | float | str) -> int:
    if not isinstance(value, str):
        return int(value)
    try:
        return int(value)
    except ValueError:
        return int(value, 0)  # 0x1f, 0b11


def _is_cut(value: Any) -> bool:
    return isinstance(value, float) and not value.is_integer()
