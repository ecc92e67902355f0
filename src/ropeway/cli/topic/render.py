"""Messages as people read them: the YAML, CSV and Python forms that ``ros2 topic`` prints."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import yaml

from ropeway.types import TypeRegistry
from ropeway.types.definition import FieldType
from ropeway.types.typedef import IDL_NAMES

__all__ = ["Picked", "Style", "as_csv", "as_python", "as_yaml", "pick", "shown"]

_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
_WIDTH: Final = (1 << 31) - 1  # as wide as the C library counts: no line is folded
_STEP: Final = re.compile(r"([A-Za-z_]\w*)|\[(\d+)\]")


@dataclass(frozen=True, slots=True)
class Style:
    """Says how much of a message is shown. ``truncate`` bounds arrays and strings, ``None`` shows all."""

    truncate: int | None = 128
    no_arr: bool = False
    no_str: bool = False
    flow: bool = False


@dataclass(frozen=True, slots=True)
class Picked:
    """A part of a message, with its type."""

    value: Any
    type: FieldType


def pick(registry: TypeRegistry, type: str, message: Mapping[str, Any], path: str) -> Picked:
    """Return the part at ``pose.position.x`` or ``ranges[3]``; the whole message for ``""``.

    Raises ``LookupError`` with a sentence.
    """
    found = Picked(message, FieldType(type))
    for piece in filter(None, path.split(".")):
        steps = list(_STEP.finditer(piece))
        if "".join(step[0] for step in steps) != piece:
            raise LookupError(f"{path!r} is not a field path; expected names joined by dots, as in pose.position.x")
        for name, index in (step.groups() for step in steps):
            found = _index(found, int(index), path) if index else _member(registry, found, name, path)
    return found


def _member(registry: TypeRegistry, part: Picked, name: str, path: str) -> Picked:
    if part.type.is_message and part.type.kind == "scalar":
        fields = registry.definition(part.type.base).wire_fields
        for field in fields:
            if field.name == name:
                return Picked(part.value[name], field.type)
        known = ", ".join(field.name for field in fields) or "none"
        raise LookupError(f"{part.type.base} has no field {name!r} (in {path!r}); its fields are: {known}")
    raise LookupError(f"{part.type.spelled()} has no fields, so {name!r} (in {path!r}) is not there")


def _index(part: Picked, index: int, path: str) -> Picked:
    if part.type.kind == "scalar":
        raise LookupError(f"{part.type.spelled()} is not an array, so [{index}] (in {path!r}) is not there")
    if index >= len(part.value):
        raise LookupError(f"[{index}] (in {path!r}) is past the end: there are {len(part.value)} elements")
    return Picked(part.value[index], FieldType(part.type.base, part.type.bound))


def shown(registry: TypeRegistry, part: Picked, style: Style) -> Any:
    """Return the part as plain lists, dicts and scalars, cut as ``style`` says."""
    if part.type.kind != "scalar":
        return _array(registry, part, style)
    if part.type.is_message:
        return {
            field.name: shown(registry, Picked(part.value[field.name], field.type), style)
            for field in registry.definition(part.type.base).wire_fields
        }
    return _scalar(part.value, style)


def _array(registry: TypeRegistry, part: Picked, style: Style) -> Any:
    type, value = part.type, part.value
    if style.no_arr:
        base = IDL_NAMES.get(type.base, type.base)
        if type.kind == "array":
            return f"<array type: {base}[{type.size}]>"
        bound = f"[{type.size}]" if type.size else ""
        return f"<sequence type: {base}{bound}, length: {len(value)}>"
    cut = style.truncate is not None and len(value) > style.truncate
    kept = value[: style.truncate] if cut else value
    if type.is_message:
        item = FieldType(type.base)
        out = [shown(registry, Picked(one, item), style) for one in kept]
    elif isinstance(kept, bytes | bytearray | memoryview):
        out = list(kept)
    else:
        out = kept.tolist() if hasattr(kept, "tolist") else [_scalar(one, style) for one in kept]
    return [*out, "..."] if cut else out


def _scalar(value: Any, style: Style) -> Any:
    if isinstance(value, str):
        if style.no_str:
            return f"<string length: <{len(value)}>>"
        if style.truncate is not None and len(value) > style.truncate:
            return value[: style.truncate] + "..."
    elif isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    return value


def as_yaml(value: Any, style: Style) -> str:
    """Write the message as YAML, without the ``---`` that follows it."""
    text: str = yaml.dump(
        value, Dumper=_Dumper, allow_unicode=True, width=_WIDTH, sort_keys=False, default_flow_style=style.flow
    )
    return text.removesuffix("...\n") if text.endswith("\n...\n") else text


def as_csv(value: Any) -> str:
    """Write all values in order, separated by commas."""
    if isinstance(value, Mapping):
        return ",".join(as_csv(item) for item in value.values())
    if isinstance(value, list):
        return ",".join(as_csv(item) for item in value)
    return str(value)


def as_python(registry: TypeRegistry, type: str, message: Mapping[str, Any], style: Style) -> str:
    """Write the message as Python: ``std_msgs.msg.String(data='hi')``."""

    def spell(part: Picked) -> str:
        if part.type.is_message and part.type.kind == "scalar":
            fields = registry.definition(part.type.base).wire_fields
            inner = ", ".join(f"{f.name}={spell(Picked(part.value[f.name], f.type))}" for f in fields)
            return f"{part.type.base.replace('/', '.')}({inner})"
        if part.type.is_message and not style.no_arr:
            item = FieldType(part.type.base)
            return f"[{', '.join(spell(Picked(one, item)) for one in part.value[: style.truncate])}]"
        return repr(shown(registry, part, style))

    return spell(Picked(message, FieldType(type)))
