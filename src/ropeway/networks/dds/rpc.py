"""The request header of rmw_cyclonedds, without I/O.

A request or reply is CDR whose body begins with 16 bytes: who asks (u64) and the number of the request (i64). The
server sends both back. Sixteen bytes keep the alignment of what follows, so bodies are cut out and set in as they are.

The library labels every message as of this machine's byte order. Numbers of requests have 32 bits in every known
implementation, so the header itself tells a sender of the other order.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

__all__ = ["HEADER_BYTES", "MAX_SEQ", "RequestHeader", "RpcMessage", "join", "split"]

HEADER_BYTES: Final = 16
MAX_SEQ: Final = 2**32 - 1

_CDR: Final = 4
_BODY: Final = _CDR + HEADER_BYTES
_LITTLE: Final = struct.Struct("<Qq")
_BIG: Final = struct.Struct(">Qq")
_LITTLE_CDR: Final = b"\0\1"
_BIG_CDR: Final = b"\0\0"
_new: Final = tuple.__new__  # of named tuples, without a call of Python


class RequestHeader(NamedTuple):
    """``client`` is a number that the client chose, ``seq`` one that it gives to one request only."""

    client: int
    seq: int


class RpcMessage(NamedTuple):
    """A request or a reply; ``payload`` is the CDR of its body, in the byte order that it claims."""

    header: RequestHeader
    payload: bytes


def join(header: RequestHeader, payload: bytes) -> bytes:
    """Return the message for little-endian CDR (with its 4-byte header).

    Raises ``struct.error`` for impossible numbers.
    """
    return b"".join((payload[:_CDR], _LITTLE.pack(*header), payload[_CDR:]))


def split(message: bytes) -> RpcMessage | None:
    """Split a message into header and payload; ``None`` for bytes that are not such a message."""
    if len(message) < _BODY:
        return None
    order = message[:2]
    if order == _LITTLE_CDR:
        header = _new(RequestHeader, _LITTLE.unpack_from(message, _CDR))
        if not 0 < header.seq <= MAX_SEQ:
            swapped = _new(RequestHeader, _BIG.unpack_from(message, _CDR))
            if 0 < swapped.seq <= MAX_SEQ:
                header, order = swapped, _BIG_CDR
    elif order == _BIG_CDR:
        header = _new(RequestHeader, _BIG.unpack_from(message, _CDR))
    else:
        return None
    return _new(RpcMessage, (header, b"".join((order, message[2:_CDR], message[_BODY:]))))
