"""The names by content: ROS 2's type hash ``RIHS01_…`` and ROS 1's MD5 sum."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from typing import Any, Final

from ropeway.errors import InvalidDefinition
from ropeway.limits import DEFINITION_NESTING
from ropeway.types.definition import FILLER, HEADER, TIMES, Definition, Field, FieldType

__all__ = ["ARRAY", "BOUNDED", "TYPE_IDS", "UNBOUNDED", "definition_md5", "describe", "interface_members", "rihs01"]

TYPE_IDS: Final = {
    "message": 1,
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "char": 3,  # the char of a .msg is IDL's uint8, whose id it gets; IDL's own char (13) no .msg can name
    "bool": 15,
    "byte": 16,
    "string": 17,
    "wstring": 18,
    "bounded string": 21,
    "bounded wstring": 22,
}
ARRAY: Final = 48
BOUNDED: Final = 96
UNBOUNDED: Final = 144

Members = Callable[[str], Sequence[tuple[str, FieldType]]]


def interface_members(full: str) -> list[tuple[str, FieldType]]:
    """Return the members that represent a service or an action in its type description."""
    if full.split("/")[1] == "action" and not full.endswith(("_SendGoal", "_GetResult")):
        ends = {
            "goal": "_Goal",
            "result": "_Result",
            "feedback": "_Feedback",
            "send_goal_service": "_SendGoal",
            "get_result_service": "_GetResult",
            "feedback_message": "_FeedbackMessage",
        }
    else:
        ends = {"request_message": "_Request", "response_message": "_Response", "event_message": "_Event"}
    return [(member, FieldType(full + end)) for member, end in ends.items()]


def rihs01(full: str, members: Members) -> str:
    """Return the type hash of ``full``; ``members`` gives names and types of the fields of any type."""
    return f"RIHS01_{hashlib.sha256(json.dumps(describe(full, members)).encode()).hexdigest()}"


def describe(full: str, members: Members) -> dict[str, Any]:
    """Return ``full`` and its parts as ``type_description_interfaces/TypeDescription`` has them, without defaults."""
    described: dict[str, dict[str, Any]] = {}
    waiting = [full]
    while waiting:
        name = waiting.pop()
        if name in described:
            continue
        fields = list(members(name)) or [(FILLER, FieldType("uint8"))]
        described[name] = {"type_name": name, "fields": [_describe_field(*field) for field in fields]}
        waiting.extend(type.base for _, type in fields if type.is_message)
    main = described.pop(full)
    return {"type_description": main, "referenced_type_descriptions": [described[name] for name in sorted(described)]}


def _describe_field(name: str, type: FieldType) -> dict[str, Any]:
    kind = "message" if type.is_message else f"bounded {type.base}" if type.bound else type.base
    offset = 0
    if type.kind == "array":
        offset = ARRAY
    elif type.kind == "sequence":
        offset = BOUNDED if type.size else UNBOUNDED
    return {
        "name": name,
        "type": {
            "type_id": offset + TYPE_IDS[kind],
            "capacity": type.size,
            "string_capacity": type.bound,
            "nested_type_name": type.base if type.is_message else "",
        },
    }


def definition_md5(full: str, definition: Callable[[str], Definition]) -> str:
    """Compute ROS 1's MD5 sum of ``full``: constants, then fields, with a message field represented by its own sum.

    Raises ``InvalidDefinition`` for a message that contains itself.
    """
    sums: dict[str, str] = {}

    def summed(name: str, depth: int) -> str:
        if depth > DEFINITION_NESTING:
            raise InvalidDefinition(
                full, f"it contains itself, or more than {DEFINITION_NESTING} messages stand one in another"
            )
        if name not in sums:
            known = definition(name)
            fields = known.fields
            if name == HEADER and fields and fields[0].name != "seq":
                fields = (Field("seq", FieldType("uint32")), *fields)
            lines = [f"{c.type} {c.name}={c.text}" for c in known.constants]
            for field in fields:
                type = field.type
                if type.base in TIMES:
                    lines.append(f"{type.spelled(type.base.rsplit('/', 1)[1].lower())} {field.name}")
                elif type.is_message:
                    lines.append(f"{summed(type.base, depth + 1)} {field.name}")
                else:
                    lines.append(f"{type.spelled()} {field.name}")
            sums[name] = hashlib.md5("\n".join(lines).encode(), usedforsecurity=False).hexdigest()
        return sums[name]

    return summed(full, 0)
