"""Packs a message for a sealed packet: whose it is and when it was received, then the payload.

::

    number u64 | stamp_ns i64 | seq u64 | origin 16 | flags u8 | encoding u8 | payload

``number`` counts what a publisher sends, without gaps, so that a reader knows what it missed; ``stamp_ns``, ``origin``
and ``seq`` are those of ``ropeway.graph.base.Sample``. Integers are big-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Final, NamedTuple

from ropeway.delivery.codec_times import DECODING
from ropeway.delivery.compression import filters
from ropeway.errors import DecodeError, MessageTooBig, SealError
from ropeway.limits import OVERLAY_BATCH_BYTES, OVERLAY_MESSAGE_BYTES
from ropeway.networks.overlay.refusal import Refusal

__all__ = ["RAW", "RELAYED", "ZSTD", "PacketItem", "frame", "pack", "read_item", "read_items", "read_packet", "unpack"]

RELAYED: Final = 1
"""The flag of a message whose origin was lost on the way here."""

RAW: Final = 0
ZSTD: Final = 1

_HEAD: Final = struct.Struct(">QqQ16sBB")
_FRAMED: Final = struct.Struct(">IQqQ16sBB")  # the same behind the length of all that follows


class PacketItem(NamedTuple):
    """A message of a packet."""

    number: int
    stamp_ns: int
    seq: int
    origin: bytes
    flags: int
    encoding: int
    payload: bytes


def frame(items: Iterable[PacketItem]) -> list[bytes]:
    """Return messages as they stand in a packet, each behind its length, in pieces to be joined."""
    pieces: list[bytes] = []
    for number, stamp_ns, seq, origin, flags, encoding, payload in items:
        size = _HEAD.size + len(payload)
        pieces.append(_FRAMED.pack(size, number, stamp_ns, seq, origin, flags, encoding))
        pieces.append(payload)
    return pieces


def pack(item: PacketItem) -> bytes:
    """Return the bytes of a message."""
    return _HEAD.pack(*item[:6]) + item.payload


def unpack(raw: bytes | memoryview) -> PacketItem:
    """Parse a message from bytes. Raises ``SealError``."""
    if len(raw) < _HEAD.size:
        raise SealError(Refusal.TRUNCATED, f"a message of {len(raw)} bytes")
    number, stamp_ns, seq, origin, flags, encoding = _HEAD.unpack_from(raw)
    if encoding not in (RAW, ZSTD):
        raise SealError(Refusal.MALFORMED, f"a message in encoding {encoding}")
    return PacketItem(number, stamp_ns, seq, origin, flags, encoding, bytes(raw[_HEAD.size :]))


def read_item(raw: bytes | memoryview, limit_bytes: int = OVERLAY_MESSAGE_BYTES) -> PacketItem:
    """Return a message with its payload as it was published, ``limit_bytes`` at most. Raises ``SealError``."""
    if len(raw) > _HEAD.size + limit_bytes:
        raise SealError(Refusal.TOO_BIG, f"a message may have {limit_bytes} bytes at most")
    item = unpack(raw)
    if item.encoding != ZSTD:
        return item
    try:
        payload = DECODING.timed("zstd", lambda: filters.decode(item.payload, limit_bytes))
        return item._replace(encoding=RAW, payload=payload)
    except MessageTooBig as error:
        raise SealError(Refusal.TOO_BIG, str(error)) from error
    except DecodeError as error:
        raise SealError(Refusal.MALFORMED, f"a compressed message ({error})") from error


def read_items(
    raws: Iterable[bytes | memoryview],
    limit_bytes: int = OVERLAY_MESSAGE_BYTES,
    more_bytes: int = OVERLAY_BATCH_BYTES,
) -> list[PacketItem]:
    """Return the messages of a packet: one of ``limit_bytes``, and others of ``more_bytes`` in all, unpacked.

    A message that would be above is refused before memory is taken for it, and with it the packet: ``SealError``.
    """
    items: list[PacketItem] = []
    left = limit_bytes + more_bytes
    for raw in raws:
        item = read_item(raw, min(limit_bytes, left))
        left -= len(item.payload)
        items.append(item)
    return items


def read_packet(
    plain: bytes, spans: Iterable[tuple[int, int]], limit_bytes: int = OVERLAY_MESSAGE_BYTES
) -> list[PacketItem]:
    """Return the messages between these ends in what a packet holds, as ``read_items`` does, for the most part faster:
    raw ones are copied once, from where they stand.
    """
    items: list[PacketItem] = []
    left = limit_bytes + OVERLAY_BATCH_BYTES
    for at, end in spans:
        begin = at + _HEAD.size
        if begin <= end <= begin + min(limit_bytes, left):
            number, stamp_ns, seq, origin, flags, encoding = _HEAD.unpack_from(plain, at)
            if encoding == RAW:
                items.append(PacketItem(number, stamp_ns, seq, origin, flags, RAW, plain[begin:end]))
                left -= end - begin
                continue
        item = read_item(memoryview(plain)[at:end], min(limit_bytes, left))  # compressed, or refused
        left -= len(item.payload)
        items.append(item)
    return items
