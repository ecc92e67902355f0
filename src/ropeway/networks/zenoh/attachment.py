"""Packs and parses what rmw_zenoh attaches to each message, request and response: a number, a time and a gid.

The format is that of Zenoh's serializer: two integers of 64 bits and 16 bytes behind their count. The first releases
of rmw_zenoh wrote the name of each part before it.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

__all__ = ["GID_BYTES", "Attachment", "pack", "parse"]

GID_BYTES: Final = 16

_PLAIN: Final = struct.Struct("<qqB16s")
_NAMED: Final = struct.Struct("<16sq17sq11sB16s")
_NUMBER_NAME: Final = b"\x0fsequence_number"
_STAMP_NAME: Final = b"\x10source_timestamp"
_GID_NAME: Final = b"\x0asource_gid"


class Attachment(NamedTuple):
    """The number that an endpoint gave to what it sent, when it sent it (nanoseconds), and its gid.

    A response has the number and the gid of its request.
    """

    number: int
    stamp_ns: int
    gid: bytes


def pack(number: int, stamp_ns: int, gid: bytes) -> bytes:
    """Return the attachment as bytes."""
    return _PLAIN.pack(number, stamp_ns, GID_BYTES, gid)


def parse(data: bytes) -> Attachment | None:
    """Parse an attachment; return ``None`` for other bytes."""
    if len(data) == _PLAIN.size:
        number, stamp_ns, size, gid = _PLAIN.unpack(data)
    elif len(data) == _NAMED.size:
        first, number, second, stamp_ns, third, size, gid = _NAMED.unpack(data)
        if (first, second, third) != (_NUMBER_NAME, _STAMP_NAME, _GID_NAME):
            return None
    else:
        return None
    if size != GID_BYTES or number < 0 or stamp_ns < 0:
        return None
    return Attachment(number, stamp_ns, gid)
