"""The ``zstd`` body: a reversible filter where the type allows one, then zstandard.

Compressors find little in camera images and point clouds, whose neighbours are nearly but not exactly equal. A
filter turns them into small differences, sorted into planes, one zstandard frame for each. The body says how to
invert itself, so that ``decode`` needs no type and no registry. Its first byte is one of

====  ========================================================================================================
0     stored: the payload as it is, where nothing helped
1     plain: one zstandard frame of the payload
2     bytes: 1 to 4 channels, green taken from red and blue, the left (and upper) neighbour taken off, one plane
      for each channel
3     16-bit numbers: the left (and upper) neighbour taken off, signs folded; low bytes, then high bytes
4     records of ``width`` bytes: each 32-bit column constant, as it is, or with the record before taken off; one
      plane for each byte of the record that is not constant
====  ========================================================================================================

Filters 2 to 4 go on with a header (``_HEADER``), the column modes of filter 4 (a byte each) and the values of the
constant columns, the bytes of the payload before and after the filtered array, and the planes, each a 32-bit length
and a zstandard frame that states its size. All numbers are little-endian. Every payload comes back bit by bit, also
one that is no valid message of its type: what a filter does not understand lies outside its array.
"""

from __future__ import annotations

import functools
import struct
import threading
from types import ModuleType
from typing import Final

from ropeway.delivery.compression import zstd
from ropeway.delivery.compression.arrays import (
    BYTES,
    CONSTANT,
    GREEN,
    MAX_STEP,
    MIN_WIDTH,
    NUMBERS,
    RECORDS,
    UPPER,
    Array,
    Data,
    filtered,
    find,
)
from ropeway.errors import DecodeError, MessageTooBig

__all__ = ["LIMIT_BYTES", "decode", "encode", "prepare"]

LIMIT_BYTES: Final = 64 << 20
"""The largest payload that ``decode`` makes unless told otherwise."""

_STORED: Final = b"\0"
_PLAIN: Final = b"\1"
_HEADER: Final = struct.Struct("<BBBxIIII")  # filter, channels, flags, head length, tail length, width, count
_LENGTH: Final = struct.Struct("<I")


class _Plain(threading.local):
    """Holds the compressor of one thread for what is not filtered."""

    def __init__(self) -> None:
        self.compress = zstd.Compressor(level=1).compress


_plain: Final = _Plain()


def prepare(type: str) -> None:
    """Load, in a thread, what messages of a type need to be filtered, so that the first of them does not wait for it.

    It is numpy, which a gateway without images and point clouds does without.
    """
    if filtered(type):
        _load_soon()


@functools.cache
def _load_soon() -> None:
    threading.Thread(target=_planes, name="ropeway filters").start()


def _planes() -> ModuleType:
    from ropeway.delivery.compression import planes

    return planes


def encode(payload: Data, type: str) -> bytes:
    """Return the ``zstd`` body of a payload of the message ``type`` (``pkg/msg/Name``); any bytes are accepted."""
    array = find(payload, type)
    if array is None:
        frame = _plain.compress(payload)
        return _PLAIN + frame if len(frame) < len(payload) else _STORED + payload
    parts = _planes().encode(payload, array)
    head, tail = payload[: array.start], payload[array.start + array.length :]
    header = _HEADER.pack(array.filter, array.channels, parts.flags, len(head), len(tail), array.width, array.count)
    pieces: list[Data] = [header, parts.modes, parts.constants, head, tail]
    for plane in parts.planes:
        pieces += (_LENGTH.pack(len(plane)), plane)
    body = b"".join(pieces)
    return body if len(body) <= len(payload) else _STORED + payload


def decode(body: Data, limit_bytes: int = LIMIT_BYTES) -> bytes:
    """Return the payload of a ``zstd`` body.

    Raises ``DecodeError`` for bytes that ``encode`` does not make, ``MessageTooBig`` where the payload would be
    above ``limit_bytes``.
    """
    kind = body[0] if len(body) else -1
    if kind == _STORED[0]:
        if len(body) - 1 > limit_bytes:
            raise MessageTooBig(len(body) - 1, limit_bytes)
        return bytes(body[1:])
    if kind == _PLAIN[0]:
        return _decompress(memoryview(body)[1:], None, limit_bytes)
    if kind not in (BYTES, NUMBERS, RECORDS):
        raise _error(f"there is no filter {kind}")
    if len(body) < _HEADER.size:
        raise _error("it ends in its header")
    _, channels, flags, head_size, tail_size, width, count = _HEADER.unpack_from(body)
    array = Array(kind, head_size, count, channels, width)
    _check(array, flags)
    total = head_size + array.length + tail_size
    if total > limit_bytes:
        raise MessageTooBig(total, limit_bytes)
    cursor = _Cursor(body, _HEADER.size)
    modes = cursor.take(width // 4 if kind == RECORDS else 0)
    constants = cursor.take(4 * bytes(modes).count(CONSTANT))
    head, tail = cursor.take(head_size), cursor.take(tail_size)
    data = _planes().decode(array, flags, modes, constants, lambda: cursor.plane(count))
    cursor.finish()
    return b"".join((head, data, tail))


def _check(array: Array, flags: int) -> None:
    """Raise ``DecodeError`` unless every field of the header is one that this filter writes."""
    most_channels, known_flags = _WRITES[array.filter]
    if array.count < 1:
        raise _error("there are no elements")
    if not 1 <= array.channels <= most_channels:
        raise _error(f"elements of {array.channels} channels")
    if flags & ~known_flags or (flags & GREEN and array.channels < 3):
        raise _error(f"filter {array.filter} has no flags {flags}")
    if flags & UPPER and not MIN_WIDTH <= array.width <= array.count * array.channels:
        raise _error(f"rows of {array.width} elements")
    if array.filter == RECORDS and not 4 <= array.width <= MAX_STEP:
        raise _error(f"records of {array.width} bytes")


_WRITES: Final = {BYTES: (4, GREEN | UPPER), NUMBERS: (1, UPPER), RECORDS: (1, 0)}  # channels at most, and flags


class _Cursor:
    """Reads a body from front to back."""

    __slots__ = ("_body", "_offset")

    def __init__(self, body: Data, offset: int) -> None:
        self._body = memoryview(body)
        self._offset = offset

    def take(self, length: int) -> memoryview:
        start = self._offset
        self._offset = end = start + length
        if end > len(self._body):
            raise _error("it is cut off")
        return self._body[start:end]

    def plane(self, size: int) -> bytes:
        (length,) = _LENGTH.unpack(self.take(4))
        return _decompress(self.take(length), size, size)

    def finish(self) -> None:
        if self._offset != len(self._body):
            raise _error(f"{len(self._body) - self._offset} bytes follow its end")


def _decompress(frame: Data, size: int | None, limit_bytes: int) -> bytes:
    """Decompress a frame, which must hold ``size`` bytes (``None``: at most ``limit_bytes``)."""
    try:
        stated = zstd.content_size(frame)
        if stated is None:
            raise _error("a frame does not state its size")
        if size is not None and stated != size:
            raise _error(f"a plane has {stated} bytes, not {size}")
        if stated > limit_bytes:
            raise MessageTooBig(stated, limit_bytes)
        return zstd.decompress(frame, stated)
    except zstd.ZstdError as error:
        raise _error(str(error)) from error


def _error(reason: str) -> DecodeError:
    return DecodeError("message", "zstd", reason)
