"""Says where and why a value does not fit its message, in the words of rosbridge.

The generated writers only notice that something is wrong; this walk over the definitions, slow and thorough, runs
afterwards to find it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

from ropeway.errors import ValueMismatch
from ropeway.types import values
from ropeway.types.definition import HEADER, ROS1_TIMES, TIMES, Definition, FieldType, short_name
from ropeway.types.layout import CODES
from ropeway.types.typedef import IDL_NAMES

__all__ = ["explain"]

_TIME_PARTS: Final = dict.fromkeys(
    [(TIMES[0], "sec"), (TIMES[1], "sec"), (ROS1_TIMES[1], "sec"), (ROS1_TIMES[1], "nanosec")], "int32"
)
_LARGEST_FLOAT32: Final = 3.4028235677973366e38  # the least number that rounds beyond the range
_INTEGERS: Final = {
    f"{sign}int{bits}": (-(1 << bits - 1), (1 << bits - 1) - 1) if not sign else (0, (1 << bits) - 1)
    for sign in ("", "u")
    for bits in (8, 16, 32, 64)
} | {"char": (0, 255), "byte": (0, 255)}


def explain(name: str, value: Any, definition: Callable[[str], Definition]) -> ValueMismatch:
    """Return the error that says what is wrong with ``value`` as a message of type ``name``."""
    walk = _Walk(name, definition)
    try:
        walk.message(name, value, (), ())
    except _Found as found:
        return ValueMismatch(name, found.field, found.reason)
    return ValueMismatch(name, "", "the value does not fit the message")


class _Found(Exception):
    def __init__(self, path: tuple[str, ...], reason: str) -> None:
        self.field = "".join(part if part.startswith("[") else f".{part}" for part in path).lstrip(".")
        self.reason = reason


class _Walk:
    """Walks over a value to find what does not fit: ``path`` names a value with indices, ``stack`` without them, as
    rosbridge's texts do.
    """

    def __init__(self, root: str, definition: Callable[[str], Definition]) -> None:
        self.root = short_name(root)
        self.definition = definition

    def message(self, name: str, value: Any, path: tuple[str, ...], stack: tuple[str, ...]) -> None:
        if name in TIMES or name in ROS1_TIMES:
            self.time(name, value, path)
            return
        if not isinstance(value, Mapping):
            if not stack:
                raise _Found(path, f"Expected a JSON object for type {self.root} but received a {type(value)}")
            raise self.mismatch(short_name(name), value, path, stack)
        fields = {field.name: field.type for field in self.definition(name).wire_fields}
        for key, inner in value.items():
            if key == "seq" and name == HEADER:
                continue  # clients of ROS 1 number their headers
            if key not in fields:
                dotted = ".".join((*stack, str(key)))
                raise _Found((*path, str(key)), f"Message type {self.root} does not have a field {dotted}")
            self.field(fields[key], inner, (*path, key), (*stack, key))

    def mismatch(self, expected: str, value: Any, path: tuple[str, ...], stack: tuple[str, ...]) -> _Found:
        return _Found(
            path, f"{self.root} message requires a {expected} for field {'.'.join(stack)}, but got a {type(value)}"
        )

    def time(self, name: str, value: Any, path: tuple[str, ...]) -> None:
        if isinstance(value, str):
            raise _Found(path, f"Invalid string for {short_name(name)}: {value!r}")
        try:
            seconds, nanoseconds = values.time_parts(value)
        except values.Misfit:
            raise _Found(path, f"{short_name(name)} takes whole numbers sec and nanosec, not {_brief(value)}") from None
        for field, number in (("sec", seconds), ("nanosec", nanoseconds)):
            base = _TIME_PARTS.get((name, field), "uint32")
            self.integer(base, number, (*path, field), (*path, field))

    def field(self, type: FieldType, value: Any, path: tuple[str, ...], stack: tuple[str, ...]) -> None:
        if type.kind == "scalar":
            self.scalar(type, value, path, stack)
            return
        if type.base in CODES and self.packed(type, value, path, stack):
            return
        if not isinstance(value, (list, tuple)):
            raise self.mismatch(_idl(type), value, path, stack)
        self.length(type, len(value), path)
        inner = FieldType(type.base, type.bound)
        for index, item in enumerate(value):
            self.scalar(inner, item, (*path, f"[{index}]"), stack)

    def packed(self, type: FieldType, value: Any, path: tuple[str, ...], stack: tuple[str, ...]) -> bool:
        """Check an array of numbers that is not a list; return true if there is nothing more to check."""
        if isinstance(value, (list, tuple)):
            return False
        if isinstance(value, str) and type.base in ("uint8", "char", "byte"):
            try:
                self.length(type, len(values.from_base64(value)), path)
            except ValueError as error:
                raise _Found(path, f"{'.'.join(stack)} is not base64: {error}") from None
            return True
        if isinstance(value, (bytes, bytearray, memoryview)) or hasattr(value, "dtype") or hasattr(value, "tag"):
            size = type.size if type.kind == "array" else f"at most {type.size}" if type.size else "any number of"
            raise _Found(
                path, f"the {'.'.join(stack)} field takes {size} values of type {_scalar(type)}, not {_brief(value)}"
            )
        raise self.mismatch(_idl(type), value, path, stack)

    def length(self, type: FieldType, count: int, path: tuple[str, ...]) -> None:
        if type.kind == "array" and count != type.size:
            raise _Found(path, f"The '{path[-1]}' field must have {type.size} elements, not {count}")
        if type.kind == "sequence" and type.size and count > type.size:
            raise _Found(path, f"The '{path[-1]}' field must have at most {type.size} elements, not {count}")

    def scalar(self, type: FieldType, value: Any, path: tuple[str, ...], stack: tuple[str, ...]) -> None:
        base = type.base
        if type.is_message:
            self.message(base, value, path, stack)
        elif base in ("string", "wstring"):
            self.string(type, value, path, stack)
        elif base in _INTEGERS:
            self.integer(base, self.number(type, value, path, stack), path, stack)
        elif base == "bool":
            if value is not True and value is not False:
                self.convert(values.truth, type, value, path, stack)
        else:
            self.real(type, value, path, stack)

    def number(self, type: FieldType, value: Any, path: tuple[str, ...], stack: tuple[str, ...]) -> int:
        if value.__class__ is int:
            return int(value)
        return int(self.convert(values.byte if type.base == "byte" else values.whole, type, value, path, stack))

    def real(self, type: FieldType, value: Any, path: tuple[str, ...], stack: tuple[str, ...]) -> None:
        try:
            number = self.convert(values.real, type, value, path, stack)
            beyond = type.base == "float32" and math.isfinite(number) and abs(number) >= _LARGEST_FLOAT32
        except OverflowError:
            beyond = True
        if beyond:
            limit = "3.402823466e+38" if type.base == "float32" else "1.7976931348623157e+308"
            raise _Found(path, f"The '{stack[-1]}' field must be a float in [-{limit}, {limit}]")

    def convert(
        self,
        by: Callable[[Any], Any],
        type: FieldType,
        value: Any,
        path: tuple[str, ...],
        stack: tuple[str, ...],
    ) -> Any:
        try:
            return by(value)
        except values.Misfit:
            raise self.primitive(type, value, path, stack) from None

    def primitive(self, type: FieldType, value: Any, path: tuple[str, ...], stack: tuple[str, ...]) -> _Found:
        if value is None:
            return _Found(path, f"msg is not a primitive type, but a {value.__class__}")
        return self.mismatch(_scalar(type), value, path, stack)

    def integer(self, base: str, value: int, path: tuple[str, ...], stack: tuple[str, ...]) -> None:
        low, high = _INTEGERS[base]
        if not low <= value <= high:
            kind = "an unsigned integer" if low == 0 else "an integer"
            raise _Found(path, f"The '{stack[-1]}' field must be {kind} in [{low}, {high}]")

    def string(self, type: FieldType, value: Any, path: tuple[str, ...], stack: tuple[str, ...]) -> None:
        if not isinstance(value, str):
            raise self.primitive(type, value, path, stack)
        try:
            coded = value.encode() if type.base == "string" else value.encode("utf-16-le")[::2]
        except UnicodeEncodeError:
            raise _Found(path, f"The '{stack[-1]}' field has half a surrogate pair") from None
        if type.bound and len(coded) > type.bound:
            raise _Found(path, f"The '{stack[-1]}' field must be string value not longer than {type.bound}")


def _scalar(type: FieldType) -> str:
    return IDL_NAMES.get(type.base, type.base)


def _idl(type: FieldType) -> str:
    """Spell the type as rosbridge's texts do: ``sequence<double, 3>``, ``float[9]``."""
    base = short_name(type.base) if type.is_message else _scalar(type)
    if type.bound:
        base = f"{base}<{type.bound}>"
    if type.kind == "array":
        return f"{base}[{type.size}]"
    if type.kind == "sequence":
        return f"sequence<{base}, {type.size}>" if type.size else f"sequence<{base}>"
    return base


def _brief(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
