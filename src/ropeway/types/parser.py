"""Reads ``.msg``, ``.srv`` and ``.action`` files and the concatenated texts of bags and peers.

Follows the rules of ROS 2 and takes ROS 1's spellings (``time``, ``duration``, ``Header``, capital letters in field
names, text constants without quotes).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from typing import Any, Final

from ropeway.errors import InvalidDefinition, InvalidTypeName
from ropeway.types.definition import (
    HEADER,
    PRIMITIVES,
    TIMES,
    Constant,
    Definition,
    Field,
    FieldType,
    canonical_name,
)

__all__ = ["parse_action", "parse_interface", "parse_msg", "parse_sections", "parse_srv"]

_LINE: Final = re.compile(
    r"(?P<base>[A-Za-z][A-Za-z0-9_/]*)(?:<=(?P<bound>\d{1,9}))?"
    r"(?:\[(?P<upto><=)?(?P<size>\d{0,9})\])?"
    r"[ \t]+(?P<name>[A-Za-z][A-Za-z0-9_]*)"
    r"(?:[ \t]*=[ \t]*(?P<constant>.*)|[ \t]+(?P<default>[^ \t].*))?\Z",
    re.DOTALL,
)
_SEPARATOR: Final = re.compile(r"^={3,}[ \t]*\r?\n(?:MSG|IDL):[ \t]*(?P<name>\S+)[ \t]*\r?$\n?", re.MULTILINE)
_SPECIAL: Final = {"time": TIMES[0], "duration": TIMES[1], "Header": HEADER}
_RANGES: Final = {
    f"{sign}int{bits}": (-(1 << bits - 1), (1 << bits - 1) - 1) if not sign else (0, (1 << bits) - 1)
    for sign in ("", "u")
    for bits in (8, 16, 32, 64)
} | {"byte": (0, 255), "char": (-128, 255)}
_LARGEST_ARRAY: Final = 1 << 27


def parse_msg(name: str, text: str, *, siblings: Collection[str] = ()) -> Definition:
    """The definition of the message ``name`` (in full) that ``text`` holds.

    ``siblings`` are types known to stand in the same package: a plain ``Header`` means the package's own only if it
    is among them. Raises ``InvalidDefinition`` with the number of the line.
    """
    package, kind, _ = name.split("/")
    fields: list[Field] = []
    constants: list[Constant] = []
    for number, raw in enumerate(text.splitlines(), 1):
        line = _without_comment(raw).strip()
        if not line or line.startswith("@"):
            continue
        try:
            found = _LINE.match(line)
            if found is None:
                raise ValueError(f"{line!r} is neither a field nor a constant")
            type = _field_type(found, package, siblings)
            if found["constant"] is not None:
                constants.append(_constant(found["name"], type, found["constant"], raw))
            else:
                default = found["default"]
                fields.append(Field(found["name"], type, None if default is None else _default(type, default.strip())))
        except ValueError as error:
            raise InvalidDefinition(name, f"line {number}: {error}") from None
    definition = Definition(name, tuple(fields), tuple(constants), text if kind == "msg" else "")
    definition.check()
    return definition


def parse_srv(name: str, text: str, *, siblings: Collection[str] = ()) -> list[Definition]:
    """Request, response and event of the service ``name``. Raises ``InvalidDefinition``."""
    request, response = _split(name, text, 2, "request --- response")
    return [
        parse_msg(f"{name}_Request", request, siblings=siblings),
        parse_msg(f"{name}_Response", response, siblings=siblings),
        _event(name),
    ]


def parse_action(name: str, text: str, *, siblings: Collection[str] = ()) -> list[Definition]:
    """The parts of the action ``name`` and of the services and topics that ROS 2 derives from it.

    Raises ``InvalidDefinition``.
    """
    goal, result, feedback = _split(name, text, 3, "goal --- result --- feedback")
    uuid = Field("goal_id", FieldType("unique_identifier_msgs/msg/UUID"))
    derived = {
        "_SendGoal_Request": (uuid, Field("goal", FieldType(f"{name}_Goal"))),
        "_SendGoal_Response": (Field("accepted", FieldType("bool")), Field("stamp", FieldType(TIMES[0]))),
        "_GetResult_Request": (uuid,),
        "_GetResult_Response": (Field("status", FieldType("int8")), Field("result", FieldType(f"{name}_Result"))),
        "_FeedbackMessage": (uuid, Field("feedback", FieldType(f"{name}_Feedback"))),
    }
    return [
        parse_msg(f"{name}_Goal", goal, siblings=siblings),
        parse_msg(f"{name}_Result", result, siblings=siblings),
        parse_msg(f"{name}_Feedback", feedback, siblings=siblings),
        *(Definition(name + end, fields) for end, fields in derived.items()),
        _event(f"{name}_SendGoal"),
        _event(f"{name}_GetResult"),
    ]


def parse_interface(name: str, text: str, *, siblings: Collection[str] = ()) -> list[Definition]:
    """The definitions in ``text``, whose kind the middle part of ``name`` tells. Raises ``InvalidDefinition``."""
    kind = name.split("/")[1]
    if kind == "srv" and not name.endswith(("_Request", "_Response", "_Event")):
        return parse_srv(name, text, siblings=siblings)
    if kind == "action" and text.count("---"):
        return parse_action(name, text, siblings=siblings)
    return [parse_msg(name, text, siblings=siblings)]


def parse_sections(name: str, text: str) -> Iterator[tuple[str, str]]:
    """The pairs of full name and text in a concatenated definition, the main one first.

    Raises ``InvalidDefinition`` for a section without a proper name.
    """
    pieces = _SEPARATOR.split(text)
    yield name, pieces[0]
    for section, body in zip(pieces[1::2], pieces[2::2], strict=True):
        try:
            yield canonical_name(section), body
        except InvalidTypeName as error:
            raise InvalidDefinition(name, str(error)) from None


def _split(name: str, text: str, count: int, wanted: str) -> list[str]:
    parts: list[list[str]] = [[]]
    for line in text.splitlines():
        if line.strip() == "---":
            parts.append([])
        else:
            parts[-1].append(line)
    if len(parts) != count:
        raise InvalidDefinition(name, f"expected {wanted}, found {len(parts)} part{'s' if len(parts) > 1 else ''}")
    return ["\n".join(lines) for lines in parts]


def _event(service: str) -> Definition:
    info = Field("info", FieldType("service_msgs/msg/ServiceEventInfo"))
    request = Field("request", FieldType(f"{service}_Request", kind="sequence", size=1))
    response = Field("response", FieldType(f"{service}_Response", kind="sequence", size=1))
    return Definition(f"{service}_Event", (info, request, response))


def _without_comment(line: str) -> str:
    if "#" not in line:
        return line
    quote = ""
    previous = ""
    for position, letter in enumerate(line):
        if quote:
            if letter == quote and previous != "\\":
                quote = ""
        elif letter == "#":
            return line[:position]
        elif letter in "\"'" and previous in "= \t[,":
            quote = letter
        previous = letter
    return line if not quote else line.partition("#")[0]


def _field_type(found: re.Match[str], package: str, siblings: Collection[str]) -> FieldType:
    base = found["base"]
    bound = int(found["bound"] or 0)
    if base not in PRIMITIVES:
        if bound:
            raise ValueError(f"{base} cannot have an upper bound; only string and wstring can")
        own = f"{package}/msg/{base}"
        if "/" in base:
            try:
                base = canonical_name(base)
            except InvalidTypeName as error:
                raise ValueError(str(error)) from None
        elif base in _SPECIAL and own not in siblings:
            base = _SPECIAL[base]
        else:
            base = own
    elif bound and base not in ("string", "wstring"):
        raise ValueError(f"{base} cannot have an upper bound; only string and wstring can")
    if found["size"] is None:
        return FieldType(base, bound)
    size = int(found["size"] or 0)
    if (found["upto"] or found["size"]) and not 0 < size <= _LARGEST_ARRAY:
        raise ValueError(f"{found['size'] or 'nothing'} is not the size of an array")
    return FieldType(base, bound, "array" if found["size"] and not found["upto"] else "sequence", size)


def _constant(name: str, type: FieldType, text: str, line: str) -> Constant:
    if type.kind != "scalar" or type.is_message:
        raise ValueError(f"the constant {name} must be of a primitive type")
    if type.base in ("string", "wstring"):
        # ROS 1 takes the rest of the line, '#' included, and so does its md5
        return Constant(name, type.base, _text(text.strip()), line.partition("=")[2].strip())
    return Constant(name, type.base, _scalar(type, text.strip()), text.strip())


def _default(type: FieldType, text: str) -> object:
    if type.is_message:
        raise ValueError("a field of a message type has no default")
    if type.kind == "scalar":
        return _scalar(type, text)
    if not (text.startswith("[") and text.endswith("]")):
        raise ValueError(f"the default of an array is written [a, b], not {text}")
    values: list[Any] = [_scalar(type, item) for item in _items(text[1:-1])]
    if (type.kind == "array" and len(values) != type.size) or (type.size and len(values) > type.size):
        raise ValueError(f"{len(values)} default values do not fit {type.spelled()}")
    return values


def _items(text: str) -> list[str]:
    return [
        m[0].strip() for m in re.finditer(r"""\s*(?:"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*'|[^,]+)""", text) if m[0].strip()
    ]


def _scalar(type: FieldType, text: str) -> bool | int | float | str:
    base = type.base
    if base in ("string", "wstring"):
        value = _text(text)
        units = len(value.encode()) if base == "string" else len(value.encode("utf-16-le")) // 2
        if type.bound and units > type.bound:
            raise ValueError(f"{text} is longer than {type.bound}")
        return value
    if base == "bool":
        if text.lower() not in ("true", "false", "0", "1"):
            raise ValueError(f"{text} is not a bool")
        return text.lower() in ("true", "1")
    try:
        if base in ("float32", "float64"):
            return float(text)
        number = int(text, 0) if not re.fullmatch(r"[-+]?0\d+", text) else int(text, 10)
    except ValueError:
        raise ValueError(f"{text} is not a value of {base}") from None
    low, high = _RANGES[base]
    if not low <= number <= high:
        raise ValueError(f"{text} is not in the range of {base}, {low} to {high}")
    return number


def _text(text: str) -> str:
    if len(text) >= 2 and text[0] == text[-1] and text[0] in "\"'":
        return text[1:-1].replace("\\" + text[0], text[0])
    return text
