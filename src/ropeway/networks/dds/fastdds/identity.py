"""Reads and writes how Fast DDS relates replies to requests: sample identities, in the inline QoS of RTPS messages.

A sample is named by its writer's GUID and its RTPS sequence number. A reply carries the identity of its request as
*related* identity; a request carries the GUID of the reader that waits for the reply, with no number. Fast DDS keeps it
in its own parameter until 2.9 (ROS 2 Humble) and in one of the standard from 2.10 on (Iron); from 2.10 on it sends
both and believes other vendors the standard one only.

Nothing here touches DDS: bytes in, values out.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

__all__ = [
    "CYCLONE",
    "FAST",
    "GUID_BYTES",
    "HEADER_BYTES",
    "NOBODY",
    "PID_RELATED",
    "PID_RELATED_OLD",
    "PREFIX_BYTES",
    "UNKNOWN_SEQ",
    "SampleIdentity",
    "SampleOrigin",
    "is_reader",
    "pack_parameter",
    "parse",
]

PID_RELATED: Final = 0x0083
PID_RELATED_OLD: Final = 0x800F

CYCLONE: Final = b"\x01\x10"
FAST: Final = b"\x01\x0f"
NOBODY: Final = bytes(16)
UNKNOWN_SEQ: Final = -1 << 32  # SEQUENCENUMBER_UNKNOWN of RTPS: high -1, low 0

HEADER_BYTES: Final = 20  # of an RTPS message
GUID_BYTES: Final = 16
PREFIX_BYTES: Final = 12  # of a GUID: what all entities of a participant share

_DATA_BYTES: Final = 24  # of a DATA submessage, to where its parameters may begin
_TO_PARAMETERS: Final = 8  # octetsToInlineQos counts from behind itself
_LITTLE_ENDIAN, _INLINE_QOS = 1, 2  # flags of DATA and of DATA_FRAG
_SENTINEL: Final = 1
_MAX_PARAMETERS: Final = 64
_IDENTITY_BYTES: Final = 24
_READER_BIT: Final = 0x04  # in the last byte of a GUID

_fixed = struct.Struct("=BBHHHIIiI")  # Cyclone DDS has turned these to this machine's byte order, in place
_prefix = struct.Struct("=3I")
_guid = struct.Struct(">4I")


class SampleIdentity(NamedTuple):
    """A sample: the GUID of who wrote it, and its number."""

    guid: bytes
    seq: int


class SampleOrigin(NamedTuple):
    """The origin of a sample: vendor of the sender, writer and number, and the related identity if it has one.

    ``parameter`` is the id under which the related identity came (the standard one if both did), 0 without.
    ``encoding`` is how the payload begins on the wire, which tells its byte order.
    """

    vendor: bytes
    identity: SampleIdentity
    related: SampleIdentity | None = None
    parameter: int = 0
    encoding: bytes = b"\0\1"


def is_reader(guid: bytes) -> bool:
    """Return whether ``guid`` is that of a reader."""
    return bool(guid[-1] & _READER_BIT)


def parse(header: bytes, submessage: bytes) -> SampleOrigin | None:
    """Read the header of an RTPS message and a DATA or DATA_FRAG of it up to its payload, as Cyclone DDS leaves them.

    ``None`` for bytes that are none.
    """
    if len(header) < HEADER_BYTES or header[:4] != b"RTPS" or len(submessage) < _DATA_BYTES:
        return None
    _, flags, _, _, to_parameters, _, entity, high, low = _fixed.unpack_from(submessage)
    guid = _guid.pack(*_prefix.unpack_from(header, HEADER_BYTES - PREFIX_BYTES), entity)
    origin = SampleOrigin(header[6:8], SampleIdentity(guid, high << 32 | low))
    if not flags & _INLINE_QOS:
        return origin
    found = _related(submessage, _TO_PARAMETERS + to_parameters, "<" if flags & _LITTLE_ENDIAN else ">")
    for parameter in (PID_RELATED, PID_RELATED_OLD):
        if parameter in found:
            return origin._replace(related=found[parameter], parameter=parameter)
    return origin


def _related(data: bytes, at: int, order: str) -> dict[int, SampleIdentity]:
    """Return the related identities in a parameter list, by parameter id; the list ends where ``data`` does, at the
    latest.
    """
    found: dict[int, SampleIdentity] = {}
    head, number = struct.Struct(order + "HH"), struct.Struct(order + "iI")
    for _ in range(_MAX_PARAMETERS):
        if at + head.size > len(data):
            break
        parameter, length = head.unpack_from(data, at)
        at += head.size
        if parameter == _SENTINEL or at + length > len(data):
            break
        if parameter in (PID_RELATED, PID_RELATED_OLD) and length >= _IDENTITY_BYTES:
            high, low = number.unpack_from(data, at + 16)
            found[parameter] = SampleIdentity(data[at : at + 16], high << 32 | low)
        at += length
    return found


def pack_parameter(parameter: int, identity: SampleIdentity) -> bytes:
    """Return a related identity as a parameter in this machine's byte order: 28 bytes."""
    seq = identity.seq
    return struct.pack("=HH16siI", parameter, _IDENTITY_BYTES, identity.guid, seq >> 32, seq & 0xFFFFFFFF)
