"""Refuses CBOR and JSON that would take far more memory than they have bytes: an empty list is one byte of CBOR.

What is short is not looked at, and of the rest mostly a few bytes are counted. JSON is read by a fast parser that makes
a tree of its own first, which takes half as much again; what is heavy is left to one that does without.
"""

from __future__ import annotations

import re
from typing import Final

from ropeway.errors import InvalidFrame
from ropeway.limits import UNPACKED_BYTES, UNPACKED_PER_BYTE

__all__ = ["check_cbor", "is_heavy_json"]

_LIST_BYTES: Final = 72
_MAP_BYTES: Final = 200
_EMPTY_MAP_BYTES: Final = 80
_SCALAR_PER_BYTE: Final = 8  # a small number takes its place in a list

_HEADS: Final = bytes(range(0x80, 0xC0))  # of lists and maps
_MAPS: Final = bytes(range(0xA0, 0xC0))
_TEXT_HEADS: Final = bytes((*range(0x42, 0x58), *range(0x62, 0x78)))

_TEXTS: Final = b"|".join(b"[\\x%02x\\x%02x].{%d}" % (0x40 + n, 0x60 + n, n) for n in range(2, 24))
_PLAIN: Final = (
    rb"[\x00-\x17\x20-\x37\xe0-\xf7\xff]|[\x18\x38\xf8].|[\x19\x39\xf9].{2}|[\x1a\x3a\xfa].{4}|[\x1b\x3b\xfb].{8}"
    rb"|[\xc0-\xd7]|\xd8.|\xd9.{2}|\xda.{4}|\xdb.{8}|[\x40\x60]|[\x41\x61]."  # Python has texts of one letter already
)
_SCALAR: Final = _PLAIN + b"|" + _TEXTS
_HEAD: Final = rb"[\x80-\x97\xa0-\xb7\x9f\xbf]"
_RUN: Final = re.compile(rb"(?:%b|%b){0,65536}" % (_HEAD, _SCALAR), re.DOTALL)  # whole items of known length
_HEADS_OF_RUN: Final = re.compile(rb"(?:%b)*(%b|\Z)" % (_SCALAR, _HEAD), re.DOTALL)  # each step takes some: no search


_PLAIN_OF_RUN: Final = re.compile(rb"(?:%b|%b)*(?:%b|\Z)" % (_TEXTS, _HEAD, _PLAIN), re.DOTALL)
_TEXT_OF_RUN: Final = re.compile(rb"(?:%b|%b)*(?:%b|\Z)" % (_PLAIN, _HEAD, _TEXTS), re.DOTALL)


def check_cbor(data: bytes | bytearray | memoryview) -> None:
    """Raise ``InvalidFrame`` if what ``data`` says would take too much memory; what is no CBOR is not judged."""
    size = len(data)
    allowed = max(UNPACKED_BYTES, UNPACKED_PER_BYTE * size)
    if size * _EMPTY_MAP_BYTES <= allowed:
        return
    raw = bytes(data)
    heads = size - len(raw.translate(None, _HEADS))
    texts = size - len(raw.translate(None, _TEXT_HEADS))
    if heads * _MAP_BYTES + texts * _TEXT_MORE_BYTES + size * _SCALAR_PER_BYTE <= allowed:
        return  # not so many bytes can begin a list, a map or a text
    weight = at = 0
    while at < size and weight <= allowed:
        run = _RUN.match(raw, at)
        assert run is not None  # it matches nothing at all, too
        end = run.end()
        weight += _weight(b"".join(_HEADS_OF_RUN.findall(raw, at, end))) + _scalars_weight(raw[at:end])
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


_TEXT_MORE_BYTES: Final = 56  # of a short text, beyond its bytes
_TREE_BYTES: Final = 16  # of each value and key in the fast parser's tree
_TEXT_BYTES: Final = 72  # of a short text and its place in a list
_NUMBER_BYTES: Final = 32  # of a number that Python has not made before: from 257 on, and with a fraction
_PLACE_BYTES: Final = 8
_FIELDS: Final = 8  # of an object; those beyond take more room, and names that come once are not shared
_FIELD_BYTES: Final = 120
_HEAVIEST_JSON: Final = 35  # for each byte: empty objects
_LONG_TEXTS: Final = re.compile(
    rb'(?:[^"]+|"[^"]{0,32}"){0,4096}((?!"[^"]{0,32}")"[^"]+"?|)'
)  # no search: each matches
_NOT_DIGITS: Final = bytes(set(range(256)) - set(b"0123456789"))


def is_heavy_json(data: bytes | bytearray | memoryview | str) -> bool:
    """Return whether a JSON text is one for the parser that takes less memory.

    Raises ``InvalidFrame`` if even that would take too much. What is no JSON is not judged.
    """
    size = len(data)
    if size * _HEAVIEST_JSON <= UNPACKED_BYTES:
        return False
    raw = data.encode(errors="replace") if isinstance(data, str) else bytes(data)
    allowed = max(UNPACKED_BYTES, UNPACKED_PER_BYTE * size)
    values, weight = _json_weight(raw)
    if weight + _TREE_BYTES * values <= allowed:
        return False
    raw = raw.replace(b"\\\\", b"  ").replace(b'\\"', b"  ")  # what is left of quotes begins and ends texts
    texts = b"".join(_LONG_TEXTS.findall(raw))  # brackets and commas in them may have misled us
    values, weight = _json_weight(raw, texts)
    if weight > allowed:
        raise InvalidFrame(f"not JSON for us: it would take more than {allowed >> 20} MiB in memory", size)
    return weight + _TREE_BYTES * values > allowed


def _json_weight(raw: bytes, long_texts: bytes = b"") -> tuple[int, int]:
    """Return about how many values and keys ``raw`` has beside ``long_texts``, and what they take in memory at most."""

    def count(byte: bytes) -> int:
        return raw.count(byte) - long_texts.count(byte)

    places, keys, lists, maps = map(count, (b",", b":", b"[", b"{"))
    texts = max(count(b'"') // 2 - keys, 0)
    numbers = max(places + 1 - texts, 0)
    digits = len(raw.translate(None, _NOT_DIGITS)) - len(long_texts.translate(None, _NOT_DIGITS))
    made = min(numbers, count(b".") + max(digits - numbers, 0) // 2)
    weight = (
        _PLACE_BYTES * places
        + _NUMBER_BYTES * made
        + _TEXT_BYTES * texts
        + _LIST_BYTES * lists
        + _MAP_BYTES * maps
        + _FIELD_BYTES * max(keys - _FIELDS * maps, 0)
    )
    return places + keys + lists + maps, weight


def _scalars_weight(run: bytes) -> int:
    """Return what the numbers and texts take that stand in a run of whole items."""
    plain, texts = (each.subn(b"", run)[1] for each in (_PLAIN_OF_RUN, _TEXT_OF_RUN))
    size = len(run)
    return min(_SCALAR_PER_BYTE * size, _NUMBER_BYTES * plain) + _TEXT_MORE_BYTES * texts + size


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
    return int.from_bytes(raw[at + 1 : end], "big"), kind, end
