"""One message as it lies inside a sealed packet: whose it is and when it was received, then the payload.

::

    number u64 | stamp_ns i64 | seq u64 | origin 16 | flags u8 | encoding u8 | payload

``number`` counts what a publisher sends, without gaps, so that a reader knows what it missed; ``stamp_ns``, ``origin``
and ``seq`` are those of ``ropeway.graph.base.Sample``. Integers are big-endian.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

from ropeway.errors import SealError
from ropeway.overlay.refusal import Refusal

__all__ = ["RAW", "RELAYED", "ZSTD", "Item", "head", "pack", "unpack"]

RELAYED: Final = 1
"""The flag of a message whose origin was lost on the way here."""

RAW: Final = 0
ZSTD: Final = 1

_HEAD: Final = struct.Struct(">QqQ16sBB")


class Item(NamedTuple):
    """A message of a packet."""

    number: int
    stamp_ns: int
    seq: int
    origin: bytes
    flags: int
    encoding: int
    payload: bytes


def head(item: Item) -> bytes:
    """What stands before the payload."""
    return _HEAD.pack(*item[:6])


def pack(item: Item) -> bytes:
    """The bytes of a message."""
    return head(item) + item.payload


def unpack(raw: bytes | memoryview) -> Item:
    """The message of some bytes. Raises ``SealError``."""
    if len(raw) < _HEAD.size:
        raise SealError(Refusal.TRUNCATED, f"a message of {len(raw)} bytes")
    number, stamp_ns, seq, origin, flags, encoding = _HEAD.unpack_from(raw)
    return Item(number, stamp_ns, seq, origin, flags, encoding, bytes(raw[_HEAD.size :]))
