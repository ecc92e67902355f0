"""Keeps definitions that peers tell: bounded, trusted as far as the peer, and forgotten with the last peer that told
them.

A definition from a graph (a publisher, a configured remote) replaces one that clients told. Between clients the first
one counts while it is connected; definitions of the system or its files are never touched.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING, Final, Protocol

from ropeway.errors import InvalidDefinition
from ropeway.limits import (
    DEFINITION_CHARACTERS,
    DEFINITION_FIELDS,
    DEFINITIONS_PER_CONNECTION,
    DEFINITIONS_PER_GATEWAY,
    FIELDS_PER_CONNECTION,
    FIELDS_PER_GRAPH,
    FIXED_ARRAY_BYTES,
    FIXED_ARRAY_OBJECTS,
)
from ropeway.types.definition import Definition

if TYPE_CHECKING:
    from ropeway.types.layout import Plan

__all__ = ["DefinitionTeller", "Told", "check_size", "check_text"]

_STATEMENT: Final = re.compile(r"^[ \t]*[A-Za-z]", re.MULTILINE)  # a line that is no comment
_FIELD_BYTES: Final = 8 << 10  # of a field, with the code that reads and writes it


class Told:
    """Records which peer told which definition of a registry."""

    def __init__(self) -> None:
        self._tellers: dict[str, set[DefinitionTeller]] = {}  # by the name of the definition

    def __contains__(self, name: str) -> bool:
        return name in self._tellers

    def __len__(self) -> int:
        return len(self._tellers)

    def replaceable(self, name: str, teller: DefinitionTeller) -> bool:
        """Return whether ``teller`` knows better: it is a graph, and only clients told ``name`` before."""
        tellers = self._tellers.get(name)
        return teller.graph and tellers is not None and not any(other.graph for other in tellers)

    def replaced(self, name: str) -> None:
        """Note that what was told of ``name`` is no longer believed."""
        self._tellers.pop(name, None)

    def enter(self, name: str, teller: DefinitionTeller) -> None:
        """Note that ``teller`` told ``name``, too."""
        self._tellers.setdefault(name, set()).add(teller)

    def leave(self, names: Iterable[str], teller: DefinitionTeller) -> list[str]:
        """Forget that ``teller`` told these; return those that nobody else did."""
        alone = []
        for name in names:
            tellers = self._tellers.get(name, set())
            tellers.discard(teller)
            if not tellers and self._tellers.pop(name, None) is not None:
                alone.append(name)
        return alone


class DefinitionStore(Protocol):
    """A registry, as those who tell definitions see it."""

    told: Told

    def has(self, name: str) -> bool:
        """Return whether a definition is known."""
        ...

    def is_guess(self, name: str) -> bool:
        """Return whether the definition is only bundled, so that a graph corrects it."""
        ...

    def add_told(self, name: str, text: str, teller: DefinitionTeller) -> None:
        """Add a concatenated definition that a peer told."""
        ...

    def forget(self, names: Collection[str]) -> None:
        """Forget definitions that nobody tells any more."""
        ...


class DefinitionTeller:
    """A peer that tells definitions. ``graph`` is true for one that a graph vouches for."""

    def __init__(self, registry: DefinitionStore, *, graph: bool = False) -> None:
        self.graph = graph
        self._registry = registry
        self._texts: dict[str, str] = {}
        self._names: set[str] = set()
        self._fields = 0

    @property
    def held_bytes(self) -> int:
        """The memory that its definitions take, with the code generated from them."""
        return self._fields * _FIELD_BYTES

    def tell(self, name: str, text: str) -> None:
        """Take the definition of ``name`` (in full) with all that it needs, unless the system has one.

        What is bundled is no more than a guess, which a graph corrects.

        Raises ``InvalidDefinition`` for one that is no good, too large or one too many, ``TypeConflict`` where others
        told something else.
        """
        registry = self._registry
        if self._texts.get(name) == text:
            return
        if registry.has(name) and name not in registry.told and not (self.graph and registry.is_guess(name)):
            return
        check_text(name, text)
        most = DEFINITIONS_PER_GATEWAY if self.graph else DEFINITIONS_PER_CONNECTION
        if len(self._texts) >= most or len(registry.told) >= DEFINITIONS_PER_GATEWAY:
            raise InvalidDefinition(name, "it is one too many; name a file with it under types in the configuration")
        registry.add_told(name, text, self)
        self._texts[name] = text

    def admit(self, name: str, definitions: list[Definition]) -> None:
        """Raise ``InvalidDefinition`` if these have more fields than anybody may tell."""
        fields = sum(map(_fields, definitions))
        if fields > DEFINITION_FIELDS:
            raise InvalidDefinition(name, f"it has {fields} fields; at most {DEFINITION_FIELDS} are taken")
        most = FIELDS_PER_GRAPH if self.graph else FIELDS_PER_CONNECTION
        if self._fields + fields > most:
            raise InvalidDefinition(name, f"with it more than {most} fields would be told")

    def added(self, names: Iterable[str], definitions: Iterable[Definition]) -> None:
        """Note what it told of what only peers have."""
        self._names.update(names)
        self._fields += sum(map(_fields, definitions))
        for name in names:
            self._registry.told.enter(name, self)

    def leave(self) -> None:
        """Forget what nobody else told."""
        self._registry.forget(self._registry.told.leave(self._names, self))
        self._texts.clear()
        self._names.clear()
        self._fields = 0


def _fields(definition: Definition) -> int:
    return len(definition.fields) + len(definition.constants)


def check_text(name: str, text: str) -> None:
    """Raise ``InvalidDefinition`` for a told text that is too long, or has too many statements, to be parsed at all."""
    if len(text) > DEFINITION_CHARACTERS:
        raise InvalidDefinition(name, f"it has {len(text)} characters; at most {DEFINITION_CHARACTERS} are taken")
    if max(len(_STATEMENT.findall(text)), text.count(";")) > 2 * DEFINITION_FIELDS:
        raise InvalidDefinition(name, f"it has more than {DEFINITION_FIELDS} fields")


def check_size(name: str, plan: Plan) -> None:
    """Raise ``InvalidDefinition`` for a told type whose empty message is large: fixed arrays make it so."""
    if plan.minimum > FIXED_ARRAY_BYTES:
        reason = f"its fixed arrays have {plan.minimum} bytes; at most {FIXED_ARRAY_BYTES} are taken"
        raise InvalidDefinition(name, reason)
    if plan.objects > FIXED_ARRAY_OBJECTS:
        reason = f"its fixed arrays have {plan.objects} texts and messages; at most {FIXED_ARRAY_OBJECTS} are taken"
        raise InvalidDefinition(name, reason)
