"""Reads the time in the header of a message without decoding it."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

from ropeway.errors import TypesError
from ropeway.types import TypeRegistry
from ropeway.types.definition import HEADER

__all__ = ["StampReader", "stamp_reader"]

StampReader = Callable[[bytes], "bytes | None"]

_AT: Final = 4  # behind the header of CDR
_BYTES: Final = 8  # seconds and nanoseconds
_NONE: Final = bytes(_BYTES)


def stamp_reader(registry: TypeRegistry, type: str) -> StampReader:
    """Return what reads the 8 bytes of the stamp from the CDR of ``type``.

    A type whose first field is no ``std_msgs/Header`` has none, and neither has a message whose stamp is zero, or of a
    type that is not known.
    """
    try:
        fields = registry.definition(type).fields
    except TypesError:
        return _no_stamp
    first = fields[0].type if fields else None
    if first is None or first.base != HEADER or first.kind != "scalar":
        return _no_stamp
    return _read


def _read(payload: bytes) -> bytes | None:
    if len(payload) < _AT + _BYTES:
        return None
    stamp = bytes(payload[_AT : _AT + _BYTES])
    if payload[1] & 1 == 0:  # big-endian
        stamp = struct.pack("<2I", *struct.unpack(">2I", stamp))
    return None if stamp == _NONE else stamp


def _no_stamp(payload: bytes) -> bytes | None:
    return None
