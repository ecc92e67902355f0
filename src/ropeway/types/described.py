"""Type descriptions, in which nodes of ROS 2 tell the definitions of their types to whoever lacks them.

A node answers ``type_description_interfaces/srv/GetTypeDescription`` under ``~/get_type_description`` with the fields
of the type and of all that it is made of, and with the files that they were read from.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

from ropeway.errors import InvalidDefinition, TypesError
from ropeway.limits import DEFINITION_FIELDS
from ropeway.types.definition import FILLER, Definition, Field, FieldType, canonical_name
from ropeway.types.hashes import ARRAY, BOUNDED, TYPE_IDS, UNBOUNDED, describe, interface_members, rihs01
from ropeway.types.interfaces import concatenated
from ropeway.types.parser import PARTS, parse_msg
from ropeway.types.registry import TypeRegistry

__all__ = ["DESCRIPTION_SERVICE", "DESCRIPTION_TYPE", "answer_for", "description_of", "full_text_of"]

DESCRIPTION_TYPE: Final = "type_description_interfaces/srv/GetTypeDescription"
DESCRIPTION_SERVICE: Final = "get_type_description"

_BASES: Final = {id: name for name, id in TYPE_IDS.items() if name != "char"}  # its id is that of uint8
_OFFSETS: Final = (("sequence", UNBOUNDED), ("sequence", BOUNDED), ("array", ARRAY))
_FIELD_NAME: Final = re.compile(r"[A-Za-z]\w*", re.ASCII)


def answer_for(registry: TypeRegistry, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return the response to a request of the service; unlike in ROS 2, the hash may be left out."""
    name, hash = asked["type_name"], asked["type_hash"]
    try:
        types: TypeRegistry | None = registry
        if hash and hash != registry.hash(name):
            types = registry.others.by_hash(registry.canonical(name), hash) if registry.others is not None else None
        if types is None:
            return {"successful": False, "failure_reason": f"{name} has another hash here: {registry.hash(name)}"}
        return description_of(types, name, sources=asked["include_type_sources"])
    except TypesError as error:
        return {"successful": False, "failure_reason": str(error)}


def description_of(registry: TypeRegistry, name: str, *, sources: bool = True) -> dict[str, Any]:
    """Return what the service answers for a type. Raises ``TypesError`` for one that is not known.

    ``sources`` says whether the texts of the definitions are told, too.
    """
    full = registry.canonical(name)
    texts: list[dict[str, str]] = []

    def members(one: str) -> list[tuple[str, FieldType]]:
        if registry.joins(one):
            return interface_members(one)
        definition = registry.definition(one)
        if sources:
            texts.append({"type_name": one, "encoding": "msg", "raw_file_contents": definition.text()})
        return [(field.name, field.type) for field in definition.fields]

    description = describe(full, members)
    for part in (description["type_description"], *description["referenced_type_descriptions"]):
        for field in part["fields"]:
            field["default_value"] = ""
    return {
        "successful": True,
        "failure_reason": "",
        "type_description": description,
        "type_sources": texts,
        "extra_information": [],
    }


def full_text_of(name: str, answer: Mapping[str, Any], hash: str = "") -> str:
    """Return the concatenated definition that an answer of the service gives of a type.

    With ``hash`` (``RIHS01_…``) the answer has to be about the type of that hash. The files that it brings count, for
    their constants and comments, where they say the same as its fields. Raises ``InvalidDefinition``.
    """
    full = canonical_name(name)
    if answer.get("successful") is not True:
        raise InvalidDefinition(full, f"nobody describes it: {answer.get('failure_reason') or 'no reason was given'}")
    try:
        members = _members(full, answer["type_description"])
        if hash and rihs01(full, lambda one: members[one]) != hash:
            raise InvalidDefinition(full, "what was described has another hash than what is published")
        texts = _texts(members, answer.get("type_sources", ()))
        roots = [full + end for end in PARTS[full.split("/")[1]]]
        if not all(root in members for root in roots):  # it is itself a part of a service or action
            roots = [full]
        main = "---\n".join(f"{texts[root].rstrip()}\n" for root in roots)
        below = [(one, texts[one]) for one in sorted(_below(members, roots).difference(roots))]
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InvalidDefinition(full, f"it is described in a way that cannot be read: {error!r}") from None
    return concatenated(main, below)


Members = dict[str, list[tuple[str, FieldType]]]


def _members(full: str, description: Mapping[str, Any]) -> Members:
    """Return names and types of the fields of everything that is described."""
    parts = [description["type_description"], *description["referenced_type_descriptions"]]
    if sum(len(part["fields"]) for part in parts) > 2 * DEFINITION_FIELDS:
        raise InvalidDefinition(full, f"it is described with more than {DEFINITION_FIELDS} fields")
    members: Members = {}
    for part in parts:
        fields = [(_name(field["name"]), _type(field["type"])) for field in part["fields"]]
        members[canonical_name(part["type_name"])] = [each for each in fields if each[0] != FILLER]
    return members


def _name(described: str) -> str:
    if not _FIELD_NAME.fullmatch(described):
        raise ValueError(f"{described[:100]!r} is not the name of a field")
    return described


def _type(described: Mapping[str, Any]) -> FieldType:
    id = described["type_id"]
    kind, offset = next((each for each in _OFFSETS if id > each[1]), ("scalar", 0))
    base = _BASES[id - offset].removeprefix("bounded ")
    if base == "message":
        base = canonical_name(described["nested_type_name"])
    return FieldType(base, described["string_capacity"], kind, described["capacity"])


def _texts(members: Members, sources: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return a text for each type: the file it was read from if that says the same, else one of its fields."""
    files = {
        canonical_name(source["type_name"]): source["raw_file_contents"]
        for source in sources
        if source["encoding"] == "msg"
    }
    texts = {}
    for name, fields in members.items():
        described = Definition(name, tuple(Field(*field) for field in fields))
        texts[name] = files[name] if _same(files.get(name), described, members) else described.text()
    return texts


def _same(text: str | None, described: Definition, members: Members) -> bool:
    if text is None:
        return False
    try:
        return parse_msg(described.name, text, siblings=members.keys()).same_layout(described)
    except TypesError:
        return False


def _below(members: Members, roots: Sequence[str]) -> set[str]:
    seen: set[str] = set()
    waiting = list(roots)
    while waiting:
        one = waiting.pop()
        if one not in seen:
            seen.add(one)
            waiting.extend(type.base for _, type in members[one] if type.is_message)
    return seen
