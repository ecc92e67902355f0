"""Messages of one type between two definitions of it, by the names of fields."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, TypeAlias

from ropeway.types.definition import Field
from ropeway.types.ros1_convert import names_between, renamed

if TYPE_CHECKING:
    from ropeway.types.registry import TypeRegistry

__all__ = ["Translate", "make_translation"]

Translate: TypeAlias = Callable[[bytes], bytes]
"""Turns CDR in one layout into CDR in another. Raises ``DecodeError``, ``ValueMismatch``."""

log = logging.getLogger("ropeway.types")


def make_translation(type: str, here: TypeRegistry, there: TypeRegistry, say: Callable[[str], None]) -> Translate:
    """Return what turns messages of ``here`` into those of ``there``; ``say`` gets what is lost by it at the first."""
    names = names_between(type, here.definition, type, there.definition)
    read, write = here.codec(type).decode, there.codec(type).encode
    untold = True

    def translate(raw: bytes) -> bytes:
        nonlocal untold
        made = write(renamed(read(raw), names))
        if untold:
            untold = False
            for difference in _differences(type, here, there):
                say(difference)
        return made

    return translate


def _differences(type: str, here: TypeRegistry, there: TypeRegistry) -> Iterator[str]:
    """Return how the definitions differ, with ``{here}``, ``{of}`` and ``{there}`` for whose they are."""
    shared = {type, *here.dependencies(type)} & {type, *there.dependencies(type)}
    for name in sorted(shared):
        mine, theirs = here.definition(name), there.definition(name)
        if mine.same_layout(theirs):
            continue
        read, written = ({f.name: f for f in each.wire_fields} for each in (mine, theirs))
        for field in written.values():
            if field.name not in read:
                yield f"{name}.{field.name} is missing {{here}}, filled with {_default(field)}"
        for gone in (each for each in read if each not in written):
            yield f"{name}.{gone}{{of}} is not known {{there}} and left out"
        if read.keys() == written.keys():
            yield f"{name}{{of}} has another layout {{there}}; its fields are carried over by name"


def _default(field: Field) -> object:
    """Return what a field holds that nobody has filled, for the log."""
    if field.default is not None:
        return field.default
    if field.type.is_message or field.type.kind != "scalar":
        return "its default"
    return {"bool": "false", "string": "an empty text", "wstring": "an empty text"}.get(field.type.base, 0)
