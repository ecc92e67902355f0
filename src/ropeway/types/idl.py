"""Reads ``.idl`` files, for packages that define messages in IDL only; the parser is that of ``rosbags``."""

from __future__ import annotations

from ropeway.errors import InvalidDefinition
from ropeway.types.definition import Definition
from ropeway.types.stores import from_rosbags

__all__ = ["parse_idl"]


def parse_idl(name: str, text: str, *, file: str = "") -> list[Definition]:
    """The definitions in ``text``, among them ``name``. Raises ``InvalidDefinition``."""
    from rosbags.typesys import TypesysError, get_types_from_idl  # a third of a gateway's start, seldom needed

    try:
        found = get_types_from_idl(text)
    except TypesysError as error:
        raise InvalidDefinition(name, str(error).splitlines()[0], file=file) from error
    if name not in found:
        raise InvalidDefinition(name, "it does not define this type", file=file)
    return [from_rosbags(each, entry) for each, entry in found.items()]
