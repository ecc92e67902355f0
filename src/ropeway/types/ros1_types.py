"""Derives the ROS 1 side of types that Ropeway knows by their ROS 2 names: layout, MD5 sum, full text.

The ROS 1 definition of a type is, in this order: what a publisher's connection header told, what ROS Noetic ships,
what a bundled package has in Noetic, what follows from the ROS 2 definition (``builtin_interfaces/Time`` becomes
``time``, the header gets its ``seq``, bounds and defaults go). The parts of an action are messages of their own in
ROS 1: ``pkg/NameGoal``, ``pkg/NameActionGoal`` and so on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

from ropeway.errors import InvalidDefinition, TypeConflict, TypesError, UnknownType
from ropeway.limits import DEFINITIONS_PER_GATEWAY
from ropeway.types import TypeRegistry
from ropeway.types.bundled import Bundled
from ropeway.types.definition import HEADER, TIMES, Definition, Field, FieldType, canonical_name, short_name
from ropeway.types.hashes import definition_md5
from ropeway.types.interfaces import owner_of
from ropeway.types.parser import parse_interface, parse_msg, parse_sections
from ropeway.types.ros1_convert import Converter
from ropeway.types.stores import store_table
from ropeway.types.told_types import DefinitionTeller, check_text

__all__ = ["ANY", "Ros1Type", "Ros1Types"]

ANY: Final = "*"
"""The MD5 sum, or type, that fits every other."""

_RULE: Final = "=" * 80
_ACTION_PARTS: Final = ("Goal", "Result", "Feedback")


@dataclass(frozen=True, slots=True)
class Ros1Type:
    """A message as ROS 1 has it.

    ``name`` as it stands on the wire (``std_msgs/String``), ``md5``, ``text`` (the message_definition of connection
    headers). ``sure`` is false where the definition is only derived from that of ROS 2.
    """

    name: str
    md5: str
    text: str
    sure: bool


class Ros1Types:
    """ROS 1's view of ``registry``; what publishers tell about types it does not know is added to it."""

    def __init__(self, registry: TypeRegistry) -> None:
        self.registry = registry
        self._store = store_table("noetic")
        self._bundled = Bundled("noetic")
        self._told: dict[str, Definition] = {}
        self._teller = DefinitionTeller(registry, graph=True)
        self._definitions: dict[str, Definition] = {}
        self._converters: dict[tuple[str, str], Converter] = {}
        self._types: dict[str, Ros1Type] = {}

    # ── definitions ────────────────────────────────────────────────────────────────────────────────────────────

    def definition(self, full: str, *, needed_by: str = "") -> Definition:
        """Return the ROS 1 definition of ``pkg/msg/Name``, or of one part of a service. Raises ``UnknownType``."""
        found = self._definitions.get(full) or self._told.get(full)
        if found is None:
            found = self._make(full, needed_by)
            self._definitions[full] = found
        return found

    def _make(self, full: str, needed_by: str) -> Definition:
        if full in self._store:
            return parse_msg(full, self._store[full])
        for source in (full, self._part_of_action(full)):
            bundled = self._bundled_part(source) if source else None
            if bundled is not None:
                return replace(bundled, name=full, source="")
            if source and self.registry.has(source):
                return _as_ros1(full, self.registry.definition(source, needed_by=needed_by))
        made = self._action_message(full)
        if made is None:
            raise UnknownType(full, needed_by=needed_by)
        return made

    def _bundled_part(self, full: str) -> Definition | None:
        """Return what a bundled package has in Noetic, unless somebody told or named another definition."""
        owner = owner_of(full)
        text = self._bundled.get(owner)
        if text is None or (self.registry.has(full) and not self.registry.is_builtin(full)):
            return None
        return next((part for part in parse_interface(owner, text) if part.name == full), None)

    def _part_of_action(self, full: str) -> str:
        """Return ``pkg/action/Name_Goal`` for ``pkg/msg/NameGoal``, ``""`` if there is no such action."""
        package, kind, name = full.split("/")
        for part in _ACTION_PARTS:
            if kind == "msg" and name.endswith(part) and self.registry.has(f"{package}/action/{name[: -len(part)]}"):
                return f"{package}/action/{name[: -len(part)]}_{part}"
        return ""

    def _action_message(self, full: str) -> Definition | None:
        """Build the definition of ``pkg/msg/NameActionGoal`` and the like."""
        package, _, name = full.split("/")
        for part in _ACTION_PARTS:
            base = name.removesuffix(f"Action{part}")
            if base != name and base:
                self.definition(f"{package}/msg/{base}{part}", needed_by=full)
                id = Field("goal_id", FieldType("actionlib_msgs/msg/GoalID"))
                status = Field("status", FieldType("actionlib_msgs/msg/GoalStatus"))
                body = Field(part.lower(), FieldType(f"{package}/msg/{base}{part}"))
                return Definition(full, (Field("header", FieldType(HEADER)), id if part == "Goal" else status, body))
        return None

    def _sure(self, full: str) -> bool:
        return all(name in self._store or name in self._told or name in TIMES for name in self._needs(full))

    def _needs(self, full: str) -> Iterator[str]:
        """Yield ``full`` and the messages that it contains, each once, in the order of their first use."""
        seen: dict[str, None] = {}
        waiting = [full]
        while waiting:
            name = waiting.pop()
            if name in seen or name in TIMES:
                continue
            seen[name] = None
            yield name
            bases = [field.type.base for field in self.definition(name).fields if field.type.is_message]
            waiting.extend(reversed(bases))

    # ── what stands in connection headers ──────────────────────────────────────────────────────────────────────

    def message(self, type: str) -> Ros1Type:
        """Return the message ``pkg/msg/Name``. Raises ``UnknownType`` and ``InvalidDefinition``."""
        found = self._types.get(type)
        if found is None:
            full = canonical_name(type)
            md5 = definition_md5(full, self.definition)
            found = self._types[type] = Ros1Type(short_name(full), md5, self._text(full), self._sure(full))
        return found

    def service(self, type: str) -> Ros1Type:
        """Return the service ``pkg/srv/Name``, whose MD5 sum covers both parts. Raises as ``message``."""
        full = canonical_name(type, "srv")
        found = self._types.get(full)
        if found is None:
            texts = [self._md5_text(f"{full}{end}") for end in ("_Request", "_Response")]
            md5 = hashlib.md5("".join(texts).encode(), usedforsecurity=False).hexdigest()
            found = self._types[full] = Ros1Type(short_name(full), md5, "", False)
        return found

    def _md5_text(self, full: str) -> str:
        """Return the text whose MD5 sum identifies a message."""
        definition = self.definition(full)
        lines = [f"{c.type} {c.name}={c.text}" for c in definition.constants]
        for field in definition.fields:
            if field.type.is_message and field.type.base not in TIMES:
                lines.append(f"{definition_md5(field.type.base, self.definition)} {field.name}")
            else:
                lines.append(f"{_spelled(field.type)} {field.name}")
        return "\n".join(lines)

    def _text(self, full: str) -> str:
        pieces: list[str] = []
        for name in self._needs(full):
            head = f"{_RULE}\nMSG: {short_name(name)}\n" if pieces else ""
            definition = self.definition(name)
            lines = [f"{c.type} {c.name}={c.text}" for c in definition.constants]
            lines += [f"{_spelled(field.type)} {field.name}" for field in definition.fields]
            pieces.append(head + "".join(f"{line}\n" for line in lines))
        return "\n".join(pieces)

    # ── values ─────────────────────────────────────────────────────────────────────────────────────────────────

    def converter(self, type: str, ros1: str = "") -> Converter:
        """Make the converter between CDR of ``type`` and the bytes of the ROS 1 message ``ros1`` (left out: of the same
        name).

        A type that only ROS 1 has is made known to the registry. Raises ``TypesError``.
        """
        key = (type, ros1)
        found = self._converters.get(key)
        if found is None:
            self.teach(type)
            codec = self.registry.codec(type)
            found = self._converters[key] = Converter(codec, self.registry.definition, ros1 or type, self.definition)
        return found

    def teach(self, type: str) -> None:
        """Make a message that only ROS 1 knows known to the registry. Raises ``TypesError``."""
        full = canonical_name(type)
        if self.registry.has(full) and full not in self.registry.told:
            return
        for name in reversed(list(self._needs(full))):
            self._teller.tell(name, _ros2_text(self.definition(name)))

    def learn(self, type: str, md5: str, text: str) -> bool:
        """Take over the definition of ``type`` that a publisher tells; true if anything is new.

        What is known for sure, does not give the sum ``md5``, or cannot be parsed is not taken: the last two raise
        ``TypesError``.
        """
        full = canonical_name(type)
        try:
            known = self.message(full)
        except TypesError:
            known = None
        if known is not None and (known.sure or known.md5 == md5):
            return False
        check_text(full, text)
        told: dict[str, Definition] = {}
        sections = list(parse_sections(full, text))
        siblings = {name for name, _ in sections if name != HEADER}
        for name, body in sections:
            for parsed in parse_interface(name, body, siblings=siblings):
                if name not in self._store:
                    told[name] = _with_seq(replace(parsed, source=""))

        def known_or_told(name: str) -> Definition:
            return told.get(name) or self.definition(name, needed_by=full)

        self._teller.admit(full, list(told.values()))
        if len(self._told) + len(told) > DEFINITIONS_PER_GATEWAY:
            raise InvalidDefinition(full, f"more than {DEFINITIONS_PER_GATEWAY} types were told by publishers")
        if (summed := definition_md5(full, known_or_told)) != md5:
            raise TypeConflict(full, f"the sum {md5}", f"a definition whose sum is {summed}")
        self._told.update(told)
        for cache in (self._definitions, self._converters, self._types):
            cache.clear()
        self.teach(full)
        return True


def _spelled(type: FieldType) -> str:
    """Spell a field's type as ROS 1 writes it."""
    if type.base in TIMES:
        return type.spelled(type.base.rsplit("/", 1)[1].lower())
    return type.spelled()


def _as_ros1(full: str, definition: Definition) -> Definition:
    """Translate a ROS 2 definition to ROS 1."""

    def plain(type: FieldType) -> FieldType:
        base = "string" if type.base == "wstring" else type.base
        return FieldType(base, 0, type.kind, type.size if type.kind == "array" else 0)

    fields = tuple(Field(field.name, plain(field.type)) for field in definition.wire_fields)
    return _with_seq(Definition(full, fields, definition.constants))


def _with_seq(definition: Definition) -> Definition:
    if definition.name == HEADER and definition.wire_fields == definition.fields:
        return replace(definition, fields=(Field("seq", FieldType("uint32")), *definition.fields))
    return definition


def _ros2_text(definition: Definition) -> str:
    return replace(definition, fields=definition.wire_fields, source="").text()
