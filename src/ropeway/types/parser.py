"""Reads ``.msg``, ``.srv`` and ``.action`` files and the concatenated texts of bags and peers.

Follows the rules of ROS 2 and takes ROS 1's spellings (``time``, ``duration``, ``Header``, capital letters in field
names, text constants without quotes, a negative ``byte``, separators longer than ``---`` or with a comment behind).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
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

__all__ = [
    "LARGEST_ARRAY",
    "PARTS",
    "RANGES",
    "derived",
    "is_idl",
    "parse_action",
    "parse_interface",
    "parse_msg",
    "parse_sections",
    "parse_srv",
]

_LINE: Final = re.compile(
    r"(?P<base>[A-Za-z][A-Za-z0-9_/]*)(?:<=(?P<bound>\d{1,9}))?"
    r"(?:\[(?P<upto><=)?(?P<size>\d{0,9})\])?"
    r"[ \t]+(?P<name>[A-Za-z][A-Za-z0-9_]*)"
    r"(?:[ \t]*=[ \t]*(?P<constant>.*)|[ \t]+(?P<default>[^ \t].*))?\Z",
    re.DOTALL,
)
_LINE_END: Final = re.compile(r"\r\n|\r|\n")
_SEPARATOR: Final = re.compile(
    r"^={3,}[ \t]*\r?\n(?P<kind>MSG|SRV|ACTION|IDL):[ \t]*(?P<name>\S+)[ \t]*\r?$\n?", re.MULTILINE
)
_MODULE: Final = re.compile(r"^[ \t]*module\s+\w+\s*\{", re.MULTILINE)
_SPECIAL: Final = {"time": TIMES[0], "duration": TIMES[1], "Header": HEADER}
RANGES: Final = {
    f"{sign}int{bits}": (-(1 << bits - 1), (1 << bits - 1) - 1) if not sign else (0, (1 << bits) - 1)
    for sign in ("", "u")
    for bits in (8, 16, 32, 64)
} | {"byte": (0, 255), "char": (-128, 255)}
"""The least and the largest number that each integer type of ROS 2 takes in a definition."""

_WRITTEN: Final = RANGES | {"byte": (-128, 255)}  # a byte is signed in ROS 1, unsigned in ROS 2; both are taken
LARGEST_ARRAY: Final = 1 << 27

PARTS: Final = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}
"""The suffixes that the written parts of each kind of interface add to its name."""


def parse_msg(name: str, text: str, *, siblings: Collection[str] = ()) -> Definition:
    """Parse the definition of the message ``name`` (in full) from ``text``.

    ``siblings`` are types known to stand in the same package: a plain ``Header`` means the package's own only if it
    is among them. Raises ``InvalidDefinition`` with the number of the line.
    """
    try:
        return _parse_lines(name, text, text.splitlines(), siblings)
    except InvalidDefinition:
        lines = _LINE_END.split(text)  # ROS 1 takes form feeds and the like in comments for no ends of lines
        if len(lines) >= len(text.splitlines()):
            raise
    return _parse_lines(name, text, lines, siblings)


def _parse_lines(name: str, text: str, lines: Sequence[str], siblings: Collection[str]) -> Definition:
    package, kind, _ = name.split("/")
    fields: list[Field] = []
    constants: list[Constant] = []
    for number, raw in enumerate(lines, 1):
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
    """Parse request, response and event of the service ``name``. Raises ``InvalidDefinition``."""
    request, response = _split(name, text, 2, "request --- response")
    return [
        parse_msg(f"{name}_Request", request, siblings=siblings),
        parse_msg(f"{name}_Response", response, siblings=siblings),
        *derived(name),
    ]


def parse_action(name: str, text: str, *, siblings: Collection[str] = ()) -> list[Definition]:
    """Parse the parts of the action ``name`` and derive its services and topics as ROS 2 does.

    Raises ``InvalidDefinition``.
    """
    goal, result, feedback = _split(name, text, 3, "goal --- result --- feedback")
    return [
        parse_msg(f"{name}_Goal", goal, siblings=siblings),
        parse_msg(f"{name}_Result", result, siblings=siblings),
        parse_msg(f"{name}_Feedback", feedback, siblings=siblings),
        *derived(name),
    ]


def derived(name: str) -> list[Definition]:
    """Derive what ROS 2 adds to the written parts: the event of a service, the services and feedback of an action."""
    kind = name.split("/")[1]
    if kind == "srv":
        return [_event(name)]
    if kind == "msg":
        return []
    uuid = Field("goal_id", FieldType("unique_identifier_msgs/msg/UUID"))
    made = {
        "_SendGoal_Request": (uuid, Field("goal", FieldType(f"{name}_Goal"))),
        "_SendGoal_Response": (Field("accepted", FieldType("bool")), Field("stamp", FieldType(TIMES[0]))),
        "_GetResult_Request": (uuid,),
        "_GetResult_Response": (Field("status", FieldType("int8")), Field("result", FieldType(f"{name}_Result"))),
        "_FeedbackMessage": (uuid, Field("feedback", FieldType(f"{name}_Feedback"))),
    }
    return [
        *(Definition(name + end, fields) for end, fields in made.items()),
        _event(f"{name}_SendGoal"),
        _event(f"{name}_GetResult"),
    ]


def parse_interface(name: str, text: str, *, siblings: Collection[str] = ()) -> list[Definition]:
    """Parse the definitions in ``text``; the middle part of ``name`` gives their kind. Raises ``InvalidDefinition``."""
    kind = name.split("/")[1]
    if kind == "srv" and not name.endswith(("_Request", "_Response", "_Event")):
        return parse_srv(name, text, siblings=siblings)
    if kind == "action" and text.count("---"):
        return parse_action(name, text, siblings=siblings)
    return [parse_msg(name, text, siblings=siblings)]


def parse_sections(name: str, text: str) -> Iterator[tuple[str, str]]:
    """Yield the pairs of full name and text in a concatenated definition, the main one first.

    Recordings in IDL head the main section, too, and may repeat a section. Raises ``InvalidDefinition`` for a
    section without a proper name.
    """
    pieces = _SEPARATOR.split(text)
    seen: set[str] = set()
    if pieces[0].strip() or len(pieces) == 1 or pieces[1] != "IDL":
        seen.add(name)
        yield name, pieces[0]
    for kind, section, body in zip(pieces[1::3], pieces[2::3], pieces[3::3], strict=True):
        try:
            full = canonical_name(section, kind.lower() if kind in ("SRV", "ACTION") else "msg")
        except InvalidTypeName as error:
            raise InvalidDefinition(name, str(error)) from None
        if kind == "MSG" or full not in seen:
            seen.add(full)
            yield full, body


def is_idl(text: str) -> bool:
    """Return whether ``text`` is written in IDL: no line of a .msg file begins like a module."""
    return _MODULE.search(text) is not None


def _split(name: str, text: str, count: int, wanted: str) -> list[str]:
    """Split a service or action into its parts, each preceded by empty lines so that its lines keep their numbers."""
    parts: list[list[str]] = [[]]
    for number, line in enumerate(_LINE_END.split(text), 1):
        if _without_comment(line).strip().startswith("---"):
            parts.append([""] * number)
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
    if (found["upto"] or found["size"]) and not 0 < size <= LARGEST_ARRAY:
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
    low, high = _WRITTEN[base]
    if not low <= number <= high:
        raise ValueError(f"{text} is not in the range of {base}, {low} to {high}")
    return number & 0xFF if base == "byte" else number


def _text(text: str) -> str:
    if len(text) >= 2 and text[0] == text[-1] and text[0] in "\"'":
        return text[1:-1].replace("\\" + text[0], text[0])
    return text
