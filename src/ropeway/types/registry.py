"""Knows every message definition, by name, without a ROS installation.

Definitions come from those that a ROS distribution ships, from a table of standard services and actions, from packages
that many robots have, from files the user names or a sourced workspace has, and from peers and bags. They are read
when they are first asked for.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Collection, Container, Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar

from ropeway.errors import InvalidDefinition, InvalidTypeName, TypeConflict, TypesError, UnknownType
from ropeway.types.bundled import Bundled
from ropeway.types.codec import MessageCodec
from ropeway.types.definition import Definition, FieldType, canonical_name
from ropeway.types.distros import OtherDistros
from ropeway.types.files import find_in_prefixes, find_interfaces, read_text
from ropeway.types.hashes import definition_md5, interface_members, rihs01
from ropeway.types.interfaces import concatenated, layout_text, owner_of, parse, parse_full, sources_of
from ropeway.types.nearest import Nearest
from ropeway.types.parser import PARTS, parse_interface, parse_msg
from ropeway.types.standard import INTERFACES
from ropeway.types.stores import NEWEST, store_table
from ropeway.types.told_types import DefinitionTeller, Told, check_size
from ropeway.types.typedef import typedefs

__all__ = ["TypeRegistry"]

log = logging.getLogger("ropeway.types")


class TypeRegistry:
    """The types of one ROS distribution and all that was added.

    ``distro`` is one of ``ropeway.types.stores.DISTROS``, ``None`` meaning ``NEWEST`` there; another raises
    ``ValueError``. Reading is safe from every thread, and adding too. Names are taken in both spellings,
    ``pkg/Name`` and ``pkg/msg/Name``. Messages in the layout that another distribution gives a type are understood,
    unless the registry is to be ``alone``.
    """

    given_distro = ""
    """The distribution that a network was said to be of."""

    make_variant: ClassVar[Callable[[TypeRegistry, str], TypeRegistry]]
    """Returns the types of a registry as another distribution has them; ``ropeway.types`` sets it."""

    def __init__(self, distro: str | None = None, *, alone: bool = False) -> None:
        self.distro = distro or NEWEST
        make = TypeRegistry.make_variant
        self.others: OtherDistros[TypeRegistry] | None = None if alone else OtherDistros(self, make)
        self.changes = 0  # how often definitions were added, replaced or forgotten
        self._store = store_table(self.distro)
        self._interfaces: Mapping[str, str] = INTERFACES
        self._bundled: Mapping[str, str] = Bundled(self.distro)
        self._lock = threading.RLock()
        self._definitions: dict[str, Definition] = {}
        self._builtin: set[str] = set()
        self._sources: dict[str, str] = {}  # services and actions: name to text
        self._files: dict[str, Path] = {}  # found in a workspace, not read yet
        self._codecs: dict[str, MessageCodec] = {}
        self._hashes: dict[str, str] = {}
        self._full_texts: dict[str, str] = {}
        self.faults: list[TypesError] = []  # definitions in files that cannot be used
        self._nearest = Nearest(lambda: (name for name in self.names() if name not in self.told))
        self.told: Told = Told()
        self._told_codecs: dict[str, set[str]] = {}  # made of told definitions, and of which

    def differs(self, type: str) -> bool:
        """Return whether a message, service or action, or anything that it is made of, is another one than ours."""
        return False

    def inward(self, type: str) -> Callable[[bytes], bytes] | None:
        """Return what turns a message of these types into ours; ``None`` where both are the same."""
        return None

    def outward(self, type: str) -> Callable[[bytes], bytes] | None:
        """Return what turns one of our messages into one of these types; ``None`` where both are the same."""
        return None

    def canonical(self, name: str, kind: str = "msg") -> str:
        """Return the full name ``pkg/msg/Name`` of a type.

        Takes ``pkg/Name`` (``kind`` is then the middle part), ``pkg/msg/Name`` and ``pkg.msg.Name``; superfluous
        slashes do not matter. Raises ``InvalidTypeName``.
        """
        return canonical_name(name, kind)

    def has(self, name: str, kind: str = "msg") -> bool:
        """Return whether the definition of a message, service or action is known."""
        try:
            full = self.canonical(name, kind)
        except InvalidTypeName:
            return False
        return self._known(full)

    def names(self, kind: str | None = None) -> list[str]:
        """Return the full names of all known interfaces, sorted; ``kind`` (msg, srv, action) selects some.

        Services and actions stand here under their own names, not with their parts.
        """
        with self._lock:
            found = {*self._store, *self._interfaces, *self._bundled, *self._added()}
        return sorted(name for name in found if kind is None or name.split("/")[1] == kind)

    def _added(self) -> set[str]:
        """Return the names of what was added, or read from what is built in."""
        added = {name for name in self._definitions if name.split("/")[1] == "msg"}
        return added.union(self._files, self._sources)

    def is_builtin(self, name: str) -> bool:
        """Return whether the message is defined exactly as in the distribution."""
        return self._known(name) and (name in self._builtin or name not in self._definitions)

    def is_guess(self, name: str) -> bool:
        """Return whether the interface belongs to a package outside the core of any distribution: a robot may have
        another.
        """
        return owner_of(name) in self._bundled and self.is_builtin(name)

    def is_standard(self, name: str) -> bool:
        """Return whether the message is defined as in this distribution or in another one."""
        return self.is_builtin(name) or (self.others is not None and self.others.have(self.definition(name)))

    def definition(self, name: str, *, needed_by: str = "") -> Definition:
        """Return the definition of a message or of one part of a service or action.

        Raises ``UnknownType`` with the nearest known name, ``InvalidDefinition`` for a file that cannot be read.
        """
        full = self.canonical(name)
        found = self._definitions.get(full)
        if found is None:
            self._load(full)
            found = self._definitions.get(full)
        if found is None:
            raise self._unknown(full, needed_by)
        return found

    def codec(self, name: str) -> MessageCodec:
        """Return the codec of a message or of one part of a service or action; it is made once and then shared.

        Raises ``UnknownType`` (also for a type that it needs), ``InvalidDefinition``, ``InvalidTypeName``.
        """
        found = self._codecs.get(name)
        if found is None:
            full = self.canonical(name)
            with self._lock:
                found = self._codecs.get(full)
                if found is None:
                    found = self._codecs[full] = self._made(full)
                if len(self._codecs) < 8192:
                    self._codecs[name] = found
        return found

    def _made(self, full: str) -> MessageCodec:
        codec = MessageCodec(full, self)
        if len(self.told):
            parts = {full, *self.dependencies(full)}
            if any(part in self.told for part in parts):
                check_size(full, codec.plan)
                self._told_codecs[full] = parts
        return codec

    def dependencies(self, name: str) -> list[str]:
        """Return the full names of all messages that ``name`` (a message, service or action) contains, each once.

        The order is that of their first use, depth first. Raises ``UnknownType``.
        """
        full = self.canonical(name)
        seen: dict[str, None] = {}
        waiting = [(base, full) for base in reversed(self._bases(full))]
        while waiting:
            base, parent = waiting.pop()
            if base not in seen and base != full:
                if not self.joins(base):
                    self.definition(base, needed_by=parent)
                seen[base] = None
                waiting.extend((inner, base) for inner in reversed(self._bases(base)))
        return [base for base in seen if not self.joins(base)]

    def hash(self, name: str) -> str:
        """Return the type hash ``RIHS01_…`` of a message, service or action, as ROS 2 announces it.

        Raises ``UnknownType``.
        """
        full = self.canonical(name)
        found = self._hashes.get(full)
        if found is None:
            found = self._hashes[full] = rihs01(full, self._members)
        return found

    def md5(self, name: str) -> str:
        """Return the MD5 sum that ROS 1 computes for this message. Raises ``UnknownType``."""
        return definition_md5(self.canonical(name), self.definition)

    def text(self, name: str) -> str:
        """Return the definition as a ``.msg``, ``.srv`` or ``.action`` file. Raises ``UnknownType``."""
        full = self.canonical(name)
        self._load(full)
        source = self._sources.get(full)
        return self.definition(full).text() if source is None else source

    def full_text(self, name: str) -> str:
        """Return the definition followed by all its dependencies, as bags store it and rosapi sends it.

        Each dependency comes after a line of 80 ``=`` and a line ``MSG: pkg/Name``. Raises ``UnknownType``.
        """
        full = self.canonical(name)
        if (found := self._full_texts.get(full)) is None:
            text = self.text(full)  # first, which loads it whole
            bases = dict.fromkeys(base for root in self.roots(full) for base in self.dependencies(root))
            found = concatenated(text, ((base, self.text(base)) for base in bases))
            self._full_texts[full] = found
        return found

    def typedefs(self, name: str) -> list[dict[str, Any]]:
        """Return the ``TypeDef`` objects of rosapi for a message and all that it contains. Raises ``UnknownType``."""
        full = self.canonical(name)
        return typedefs([full, *self.dependencies(full)], self.definition)

    def add_text(self, name: str, text: str, *, replace: bool = False, file: str = "") -> None:
        """Add one definition; the middle part of ``name`` tells whether ``text`` is a .msg, .srv or .action.

        The same layout again changes nothing. Another layout raises ``TypeConflict``, unless the known one is
        built in and ``replace`` is true. Raises ``InvalidDefinition`` (``file`` is named in it).
        """
        full = self.canonical(name)
        special = f"{full.split('/')[0]}/msg/Header"
        try:
            definitions = parse(full, text, siblings={special} if self._known(special) else ())
        except InvalidDefinition as error:
            if not file:
                raise
            raise InvalidDefinition(error.name, error.reason, file=file) from None
        self._add(definitions, sources_of(full, text, definitions), replace=replace)

    def add_full_text(self, name: str, text: str, *, replace: bool = False) -> None:
        """Add a concatenated definition: the main text, then sections headed ``MSG: pkg/Name`` (or ``IDL:``).

        All or nothing is added. Errors as in ``add_text``.
        """
        self._add(*parse_full(self.canonical(name), text), replace=replace)

    def add_unknown(self, name: str, text: str) -> None:
        """Add what is not known yet, or only guessed, of a concatenated definition. Raises ``InvalidDefinition``."""
        definitions, sources = parse_full(self.canonical(name), text)
        with self._lock:
            over = self._guessed_wrong(definitions)
            fresh = [each for each in definitions if each.name in over or not self._known(each.name)]
            names = {owner_of(each.name) for each in fresh}
            self._add(fresh, {each: source for each, source in sources.items() if each in names}, over=over)

    def add_told(self, name: str, text: str, teller: DefinitionTeller) -> None:
        """Add a concatenated definition that a peer told; ``DefinitionTeller.tell`` is the way to call it."""
        full = self.canonical(name)
        definitions, sources = parse_full(full, text)
        definitions = [each for each in definitions if not self._is_of_another(each)]
        teller.admit(full, definitions)
        with self._lock:
            names = [*(definition.name for definition in definitions), *sources]
            over = {each for each in names if self.told.replaceable(each, teller)}
            if teller.graph:
                over |= self._guessed_wrong(definitions)
            known = {each for each in names if self._known(each)}
            self._add(definitions, sources, over=over)
            for each in over:
                self.told.replaced(each)
            mine = {each for each in names if each not in known or each in over or each in self.told}
            teller.added(mine, [definition for definition in definitions if definition.name in mine])

    def forget(self, names: Collection[str]) -> None:
        """Remove definitions that nobody tells any more, and what was made of them."""
        if not names:
            return
        with self._lock:
            self.changes += 1
            for name in names:
                self._definitions.pop(name, None)
                self._sources.pop(name, None)
            stale = {full for full, parts in self._told_codecs.items() if not parts.isdisjoint(names)}
            for full in stale:
                del self._told_codecs[full]
            self._codecs = {key: codec for key, codec in self._codecs.items() if codec.type not in stale}
            self._hashes.clear()
            self._full_texts.clear()

    def add_path(self, path: str | os.PathLike[str]) -> int:
        """Add a ``.msg``, ``.srv``, ``.action`` or ``.idl`` file, or all of them below a directory.

        Returns how many interfaces were found. What they define takes the place of built-in definitions. One that
        cannot be read is logged and stands in ``faults``, and whoever needs it gets the error. Raises
        ``InvalidDefinition`` where ``path`` itself is of no use.
        """
        found = find_interfaces(Path(path))
        with self._lock:
            for name in sorted(found, key=lambda name: not name.endswith("/msg/Header")):  # its siblings look for it
                self._try_to_read(name, found[name])
        return len(found)

    def add_ament_prefix_path(self, environ: Mapping[str, str] = os.environ) -> int:
        """Make known what the sourced ROS 2 workspaces define; files are read when first needed.

        ``environ`` holds ``AMENT_PREFIX_PATH``, earlier entries win. These definitions take the place of built-in
        ones. Returns how many interfaces were found.
        """
        found = find_in_prefixes(environ.get("AMENT_PREFIX_PATH", ""))
        with self._lock:
            loaded = {owner_of(name) for name in self._builtin}
            for name, file in found.items():
                if name in loaded or (name not in self._definitions and name not in self._sources):
                    self._files.setdefault(name, file)
            self._nearest.forget()
            for name in loaded & found.keys():
                if name in self._files:
                    self._try_to_read(name, self._files.pop(name))
        return len(found)

    def _known(self, full: str) -> bool:
        owner = owner_of(full)
        return any(
            name in table
            for name in (full, owner)
            for table in (self._definitions, self._sources, self._files, self._interfaces, self._store, self._bundled)
        )

    def _load(self, full: str) -> None:
        """Read the definition of ``full`` from where it waits, if it does."""
        with self._lock:
            owner = owner_of(full)
            for name in (full, owner):
                file = self._files.pop(name, None)
                if file is not None:
                    try:
                        self._read(name, file)
                    except InvalidDefinition:
                        self._files[name] = file
                        raise
                    return
            if full in self._definitions or full in self._sources:
                return
            if full in self._store:
                self._add_builtin([parse_msg(full, self._store[full])])
                return
            text = self._interfaces.get(owner)
            if text is None:
                text = self._bundled.get(owner)
            if text is not None:
                self._add_builtin(parse_interface(owner, text))
                if owner not in self._definitions:
                    self._sources.setdefault(owner, text)

    def _add_builtin(self, definitions: Iterable[Definition]) -> None:
        for definition in definitions:
            if self._definitions.setdefault(definition.name, definition) is definition:
                self._builtin.add(definition.name)

    def _guessed_wrong(self, definitions: Iterable[Definition]) -> set[str]:
        """Return the names of those that a bundled package has in another layout."""
        guesses = [each for each in definitions if self.is_guess(each.name)]
        return {each.name for each in guesses if not self.definition(each.name).same_layout(each)}

    def _is_of_another(self, definition: Definition) -> bool:
        """Return whether this is a standard message as another distribution defines it, for which our own stands in."""
        name, others = definition.name, self.others
        return others is not None and self._known(name) and self.is_standard(name) and others.have(definition)

    def _try_to_read(self, name: str, file: Path) -> None:
        try:
            self._read(name, file)
        except InvalidDefinition as error:
            self._files[name] = file
            self._fault(error)
        except TypeConflict as error:
            self._fault(error)

    def _fault(self, error: TypesError) -> None:
        log.warning("%s", error)
        self.faults.append(error)

    def _read(self, name: str, file: Path) -> None:
        self.add_text(name, read_text(file, name), replace=True, file=str(file))

    def _add(
        self,
        definitions: Iterable[Definition],
        sources: Mapping[str, str],
        *,
        replace: bool = False,
        over: Container[str] = (),
    ) -> None:
        """Add definitions; ``over`` names those that take the place of others of their name."""
        self._nearest.forget()
        with self._lock:
            fresh: dict[str, Definition] = {}
            changed = False
            for definition in definitions:
                name = definition.name
                if name not in self._definitions:
                    self._load(name)
                known = fresh.get(name) or self._definitions.get(name)
                if known is not None:
                    replaces = ((replace and name in self._builtin) or name in over) and name not in fresh
                    if known.same_layout(definition):
                        if not replaces:
                            continue
                    elif not replaces:
                        raise TypeConflict(name, layout_text(known), layout_text(definition))
                    changed = True
                fresh[name] = definition
            self._definitions.update(fresh)
            self._builtin.difference_update(fresh)
            self.changes += bool(fresh)
            if fresh or not all(name in self._sources for name in sources):
                self._sources.update(sources)
            if changed:
                self._forget()

    def _forget(self) -> None:
        self._codecs.clear()
        self._told_codecs.clear()
        self._hashes.clear()
        self._full_texts.clear()

    def _bases(self, full: str) -> list[str]:
        return [base for _, type in self._members(full) if type.is_message and (base := type.base)]

    def _members(self, full: str) -> list[tuple[str, FieldType]]:
        """Return field names and types of a message, or of the structure that stands for a service or action."""
        if self.joins(full):
            return interface_members(full)
        return [(field.name, field.type) for field in self.definition(full).fields]

    def joins(self, full: str) -> bool:
        """Return whether ``full`` is no message but joins some: a service or action, or a service of an action."""
        self._load(full)
        return full in self._sources or (full not in self._definitions and full + "_Event" in self._definitions)

    def roots(self, full: str) -> list[str]:
        """Return the messages whose fields stand in the text of ``full`` itself."""
        if full not in self._sources:
            return [full]
        return [full + end for end in PARTS[full.split("/")[1]]]

    def _unknown(self, full: str, needed_by: str) -> UnknownType:
        with self._lock:
            return UnknownType(full, needed_by=needed_by, nearest=self._nearest.to(full))
