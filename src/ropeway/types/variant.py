"""The types of one network where they differ from ours: those of its distribution of ROS 2, and those of its own files.

Two networks that meet in a gateway may define one type differently: Humble's ``Range`` has no ``variance``, and a
package of the user's may be of another version there.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Collection, Iterable, Sequence
from typing import TYPE_CHECKING

from ropeway.errors import TypesError
from ropeway.types.bundled import Bundled
from ropeway.types.codec import MessageCodec
from ropeway.types.definition import Definition
from ropeway.types.distros import CHANGED, ROS2_DISTROS
from ropeway.types.interfaces import owner_of
from ropeway.types.registry import TypeRegistry
from ropeway.types.translation import Translate, make_translation

if TYPE_CHECKING:
    from ropeway.types.told_types import DefinitionTeller

__all__ = ["Variant", "make_network"]

log = logging.getLogger("ropeway.types")


class Variant(TypeRegistry):
    """The types of ``ours`` as a network of ``distro`` has them, or as the definitions below ``paths`` do.

    Everything else is that of ``ours``, whatever becomes of it; what peers tell goes there, too. ``label`` says in the
    log whose types these are. Raises ``ValueError`` for a distribution that is not known, ``InvalidDefinition`` for a
    path that is of no use.
    """

    def __init__(
        self, ours: TypeRegistry, distro: str = "", paths: Iterable[str | os.PathLike[str]] = (), *, label: str = ""
    ) -> None:
        if distro and distro not in ROS2_DISTROS:
            raise ValueError(f"{distro!r} is not a ROS 2 distribution; known are {', '.join(ROS2_DISTROS)}")
        super().__init__(distro or ours.distro, alone=True)
        self.given_distro = distro
        self.label = label or distro.title() or "the network"
        self.ours = ours
        self.told = ours.told
        self._interfaces = {}
        self._store = {name: self._store[name] for name in CHANGED if distro and name in self._store}
        self._bundled = Bundled(distro, changed=True) if distro else {}
        self._seen = (0, 0)  # states of ours and of this
        self._different: dict[str, bool] = {}
        self._translations: dict[tuple[str, bool], Translate] = {}
        self._said: set[str] = set()
        for path in paths:
            self.add_path(path)
        for name in self._added():
            if not ours.has(name):
                ours.add_full_text(name, self.full_text(name))

    def differs(self, type: str) -> bool:
        """Return whether a message, service or action, or anything that it is made of, is another one here."""
        self._follow()
        found = self._different.get(type)
        if found is None:
            try:
                names = [type, *self.dependencies(type)]
            except TypesError:
                return False
            found = self._different[type] = any(self.changes_layout(name) for name in names)
        return found

    def inward(self, type: str) -> Translate | None:
        """Return what turns a message of this network into ours; ``None`` where both are the same."""
        return self._translation(type, inward=True)

    def outward(self, type: str) -> Translate | None:
        """Return what turns one of our messages into that of this network; ``None`` where both are the same."""
        return self._translation(type, inward=False)

    def changes_layout(self, name: str) -> bool:
        """Return whether the message ``name`` itself has other fields here."""
        if not self._is_own(name) or self.joins(name) or not self.ours.has(name):
            return False
        return not self.definition(name).same_layout(self.ours.definition(name))

    def definition(self, name: str, *, needed_by: str = "") -> Definition:
        """See ``TypeRegistry``."""
        full = self.canonical(name)
        if self._is_own(full):
            return super().definition(full, needed_by=needed_by)
        return self.ours.definition(full, needed_by=needed_by)

    def codec(self, name: str) -> MessageCodec:
        """See ``TypeRegistry``; that of ours where nothing differs."""
        full = self.canonical(name)
        return super().codec(full) if self.differs(full) else self.ours.codec(full)

    def hash(self, name: str) -> str:
        """See ``TypeRegistry``."""
        full = self.canonical(name)
        return super().hash(full) if self.differs(full) else self.ours.hash(full)

    def text(self, name: str) -> str:
        """See ``TypeRegistry``."""
        full = self.canonical(name)
        return super().text(full) if self._is_own(full) else self.ours.text(full)

    def full_text(self, name: str) -> str:
        """See ``TypeRegistry``."""
        self._follow()
        return super().full_text(name)

    def names(self, kind: str | None = None) -> list[str]:
        """See ``TypeRegistry``."""
        return sorted({*super().names(kind), *self.ours.names(kind)})

    def add_told(self, name: str, text: str, teller: DefinitionTeller) -> None:
        """See ``TypeRegistry``."""
        self.ours.add_told(name, text, teller)

    def forget(self, names: Collection[str]) -> None:
        """See ``TypeRegistry``."""
        self.ours.forget(names)

    def _translation(self, type: str, *, inward: bool) -> Translate | None:
        if not self.differs(type):
            return None
        found = self._translations.get((type, inward))
        if found is None:
            here, there = (self, self.ours) if inward else (self.ours, self)
            at = f"in {self.label}"
            words = (
                {"here": at, "of": f" of {self.label}", "there": "here"}
                if inward
                else {"here": "here", "of": "", "there": at}
            )
            found = make_translation(type, here, there, lambda text: self._say(text.format(**words)))
            self._translations[type, inward] = found
        return found

    def _say(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            log.warning("%s", text)

    def _is_own(self, full: str) -> bool:
        """Return whether this network defines the type itself; a distribution counts only where ours is a
        distribution's, too.
        """
        if not super()._known(full):
            return False
        shipped = full in self._store or owner_of(full) in self._bundled
        return not shipped or (full in self._sources and full not in self._bundled) or self.ours.is_standard(full)

    def _known(self, full: str) -> bool:
        return self._is_own(full) or self.ours.has(full)

    def joins(self, full: str) -> bool:
        """See ``TypeRegistry``."""
        return super().joins(full) or self.ours.joins(full)

    def roots(self, full: str) -> list[str]:
        """See ``TypeRegistry``."""
        return super().roots(full) if self._is_own(full) else self.ours.roots(full)

    def _follow(self) -> None:
        """Forget what was made of definitions, ours or of this network, that have changed since."""
        state = (self.ours.changes, self.changes)
        if self._seen != state:
            self._seen = state
            self._forget()
            self._different.clear()
            self._translations.clear()


def make_network(
    ours: TypeRegistry, distro: str | None, paths: Sequence[str | os.PathLike[str]] = (), *, label: str
) -> Variant | None:
    """Return the types of a network of which the distribution, or files, are given; ``None`` where nothing is.

    Raises as ``Variant`` does.
    """
    if paths or (distro and ours.others is None):
        return Variant(ours, distro or "", paths, label=label)
    variant = ours.others.variant(distro) if distro and ours.others is not None else None
    assert variant is None or isinstance(variant, Variant)
    return variant
