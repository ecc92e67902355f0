"""Reads CBOR from other members, but only of the plain kind that gateways make, and small enough to hold.

A list of a million empty lists has a million bytes, and takes a hundred million once it is decoded. So items are
counted first, before anything is decoded; texts and bytes are stepped over, however long they are.
"""

from __future__ import annotations

from typing import Any, Final

import cbor2

from ropeway.errors import SealError
from ropeway.limits import OVERLAY_NESTED_CONTAINERS, OVERLAY_NOTE_ITEMS
from ropeway.networks.overlay.refusal import Refusal

__all__ = ["loads", "pair"]

_BYTES, _TEXT, _LIST, _MAP, _TAG, _SIMPLE = range(2, 8)  # major types; 0 and 1 are numbers
_FOLLOWING: Final = {24: 1, 25: 2, 26: 4, 27: 8}  # bytes of the argument behind the first, by its low five bits


def loads(raw: bytes | memoryview, what: str, *, items: int = OVERLAY_NOTE_ITEMS) -> Any:
    """Return the value in ``raw``: numbers, texts, bytes, lists and maps, ``items`` of them at most.

    Raises ``SealError`` (MALFORMED, with ``what`` it is) for anything else.
    """
    try:
        _measure(raw, items)
        return cbor2.loads(raw)
    except Exception as error:  # of a library that reads what others wrote
        raise SealError(Refusal.MALFORMED, what) from error


def pair(raw: bytes | memoryview, what: str) -> tuple[bytes, bytes]:
    """Return a text and its signature. Raises ``SealError`` (MALFORMED)."""
    found = loads(raw, what)
    if not isinstance(found, list) or len(found) != 2 or any(type(part) is not bytes for part in found):
        raise SealError(Refusal.MALFORMED, what)
    return found[0], found[1]


def _measure(raw: bytes | memoryview, items: int) -> None:
    """Step over one value. Raises ``ValueError``, ``IndexError`` or ``KeyError`` where it is not to be read."""
    at, size = 0, len(raw)
    open_: list[int] = [1]  # how many values are still to come, of each container that is open
    while open_:
        if not open_[-1]:
            open_.pop()
            continue
        open_[-1] -= 1
        items -= 1
        if items < 0:
            raise ValueError("too many values")
        first = raw[at]
        at += 1
        kind, argument = first >> 5, first & 31
        if argument >= 24:
            more = _FOLLOWING[argument]  # no indefinite lengths
            argument = int.from_bytes(raw[at : at + more], "big")
            at += more
        if kind in (_BYTES, _TEXT):
            at += argument
        elif kind in (_LIST, _MAP):
            if len(open_) > OVERLAY_NESTED_CONTAINERS or argument > items:
                raise ValueError("too deep, or too many values")
            open_.append(argument * (2 if kind == _MAP else 1))
        elif kind == _TAG:
            raise ValueError("a tag")
        if at > size:
            raise ValueError("cut short")
    if at != size:
        raise ValueError("more than one value")
