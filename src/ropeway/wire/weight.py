"""Refuses CBOR that would take far more memory than it has bytes: an empty list is one byte, and 64 in memory.

JSON needs no such look: whatever it says takes at most 24 times its text.
"""

from __future__ import annotations

import re
from typing import Final

from ropeway.errors import InvalidFrame
from ropeway.limits import UNPACKED_BYTES, UNPACKED_PER_BYTE

__all__ = ["check_cbor"]

_LIST_BYTES: Final = 64
_MAP_BYTES: Final = 184
_EMPTY_MAP_BYTES: Final = 72
_SCALAR_PER_BYTE: Final = 8  # a number of three bytes takes 32, a text its characters and 50

_HEADS: Final = bytes(range(0x80, 0xC0))  # of lists and maps
_MAPS: Final = bytes(range(0xA0, 0xC0))

_TEXTS: Final = b"|".join(b"[\\x%02x\\x%02x].{%d}" % (0x40 + n, 0x60 + n, n) for n in range(24))
_SCALAR: Final = (
    rb"[\x00-\x17\x20-\x37\xe0-\xf7\xff]|[\x18\x38\xf8].|[\x19\x39\xf9].{2}|[\x1a\x3a\xfa].{4}|[\x1b\x3b\xfb].{8}"
    rb"|[\xc0-\xd7]|\xd8.|\xd9.{2}|\xda.{4}|\xdb.{8}|" + _TEXTS
)
_HEAD: Final = rb"[\x80-\x97\xa0-\xb7\x9f\xbf]"
_RUN: Final = re.compile(rb"(?:%b|%b){0,65536}+" % (_HEAD, _SCALAR), re.DOTALL)  # whole items of known length
_HEADS_OF_RUN: Final = re.compile(rb"(?:%b)*+(%b|\Z)" % (_SCALAR, _HEAD), re.DOTALL)  # each step takes some: no search


def check_cbor(data: bytes | bytearray | memoryview) -> None:
    """Raise ``InvalidFrame`` if what ``data`` says would take too much memory; what is no CBOR is not judged."""
    size = len(data)
    allowed = max(UNPACKED_BYTES, UNPACKED_PER_BYTE * size)
    if size * _EMPTY_MAP_BYTES <= allowed:
        return
    raw = bytes(data)
    heads = size - len(raw.translate(None, _HEADS))
    if heads * _MAP_BYTES + size * _SCALAR_PER_BYTE <= allowed:
        return  # not so many bytes can begin a list or a map
    weight = at = 0
    while at < size and weight <= allowed:
        run = _RUN.match(raw, at)
        assert run is not None  # it matches nothing at all, too
        end = run.end()
        weight += _SCALAR_PER_BYTE * (end - at) + _weight(b"".join(_HEADS_OF_RUN.findall(raw, at, end)))
        if end == at:
            length, kind, end = _head(raw, at)
            if kind in (2, 3):
                end += length
                weight += length
            else:
                weight += _MAP_BYTES
        at = end
    if weight > allowed:
        raise InvalidFrame(f"not CBOR for us: it would take more than {allowed >> 20} MiB in memory", size)


def _weight(heads: bytes) -> int:
    """Return what the lists and maps take that begin with these bytes."""
    lists = len(heads.translate(None, _MAPS))
    empty = heads.count(0xA0)
    return _LIST_BYTES * lists + _EMPTY_MAP_BYTES * empty + _MAP_BYTES * (len(heads) - lists - empty)


def _head(raw: bytes, at: int) -> tuple[int, int, int]:
    """Return the length, the major type and the end of the head that begins at ``at``; 1 for a length not told."""
    kind, low = raw[at] >> 5, raw[at] & 31
    if low < 24:
        return low, kind, at + 1
    if low > 27:
        return (0 if kind in (2, 3) else 1), kind, at + 1
    end = at + 1 + (1 << (low - 24))
    return int.from_bytes(raw[at + 1 : end]), kind, end
