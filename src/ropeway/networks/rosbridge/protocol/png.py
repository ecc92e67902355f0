"""The ``png`` encoding of rosbridge: a text as the pixels of an RGB image."""

from __future__ import annotations

import math
import struct
import zlib
from typing import Final

import numpy as np
import numpy.typing as npt

from ropeway.errors import DecodeError, MessageTooBig

__all__ = ["pack", "unpack"]

_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
_IHDR: Final = struct.Struct(">IIBBBBB")
_U32: Final = struct.Struct(">I")
_RGB8: Final = (8, 2, 0, 0, 0)
_LEVEL: Final = 4  # of zlib: half the time of its default, a few percent more bytes
_SLOW_LIMIT_BYTES: Final = 4 << 20  # rows that only plain Python can restore; about a second

_U8 = npt.NDArray[np.uint8]


def pack(text: bytes) -> bytes:
    """Return the PNG of a text: as square as can be, padded with line feeds."""
    width = max(1, math.isqrt(len(text) // 3))
    height = max(1, -(-len(text) // (3 * width)))
    rows = np.zeros((height, 1 + 3 * width), np.uint8)  # each begins with the number of its filter: none
    rows[:, 1:] = np.frombuffer(text.ljust(3 * width * height, b"\n"), np.uint8).reshape(height, 3 * width)
    header = _IHDR.pack(width, height, *_RGB8)
    data = zlib.compress(rows.data, _LEVEL)
    return b"".join((_SIGNATURE, *_chunk(b"IHDR", header), *_chunk(b"IDAT", data), *_chunk(b"IEND", b"")))


def _chunk(kind: bytes, data: bytes) -> tuple[bytes, ...]:
    return _U32.pack(len(data)), kind, data, _U32.pack(zlib.crc32(data, zlib.crc32(kind)))


def unpack(image: bytes | memoryview, *, limit_bytes: int) -> bytes:
    """Return the text of a PNG as any rosbridge server makes it, without the padding.

    Raises ``DecodeError``, and ``MessageTooBig`` where the text is above ``limit_bytes``.
    """
    try:
        width, height, data = _read(bytes(image))
        size = width * height * 3
        if size > limit_bytes + 3 * width:
            raise MessageTooBig(size, limit_bytes)
        inflater = zlib.decompressobj()
        rows = inflater.decompress(data, size + height)
        if len(rows) != size + height or inflater.decompress(inflater.unconsumed_tail, 1):
            raise _error("the pixels do not fill the image")
    except (struct.error, zlib.error) as error:
        raise _error(str(error)) from None
    return _restore(np.frombuffer(rows, np.uint8).reshape(height, 1 + 3 * width)).tobytes().rstrip(b"\n")


def _read(image: bytes) -> tuple[int, int, bytes]:
    """Return width, height and compressed rows."""
    if not image.startswith(_SIGNATURE):
        raise _error("it does not begin like a PNG")
    at = len(_SIGNATURE)
    parts: list[bytes] = []
    size: tuple[int, int] | None = None
    while True:
        (length,) = _U32.unpack_from(image, at)
        kind, data = image[at + 4 : at + 8], image[at + 8 : at + 8 + length]
        if kind == b"IEND":
            break
        (check,) = _U32.unpack_from(image, at + 8 + length)
        if zlib.crc32(data, zlib.crc32(kind)) != check:
            raise _error("a checksum is wrong")
        if kind == b"IHDR":
            width, height, *form = _IHDR.unpack(data)
            if tuple(form) != _RGB8 or not width or not height:
                raise _error("it is not an RGB image of 8 bits")
            size = width, height
        elif kind == b"IDAT":
            parts.append(data)
        at += 12 + length
    if size is None:
        raise _error("it has no header")
    return *size, b"".join(parts)


def _restore(rows: _U8) -> _U8:
    """Undo the filter of each row."""
    filters = rows[:, 0]
    pixels = np.array(rows[:, 1:])
    if not filters.any():
        return pixels
    if int((filters > 2).sum()) * pixels.shape[1] > _SLOW_LIMIT_BYTES:
        raise _error("too many rows are filtered by average or Paeth")
    above = np.zeros(pixels.shape[1], np.uint8)
    for number, row in zip(filters.tolist(), pixels, strict=True):
        if number == 1:
            np.add.accumulate(row.reshape(-1, 3), axis=0, dtype=np.uint8, out=row.reshape(-1, 3))
        elif number == 2:
            row += above
        elif number in (3, 4):
            row[:] = (_average if number == 3 else _paeth)(row.tolist(), above.tolist())
        elif number:
            raise _error(f"there is no filter {number}")
        above = row
    return pixels


def _average(row: list[int], above: list[int]) -> list[int]:
    for i, upper in enumerate(above):
        left = row[i - 3] if i >= 3 else 0
        row[i] = (row[i] + ((left + upper) >> 1)) & 255
    return row


def _paeth(row: list[int], above: list[int]) -> list[int]:
    left = corner = 0
    for i, upper in enumerate(above):
        if i >= 3:
            left, corner = row[i - 3], above[i - 3]
        by_left, by_upper, by_corner = abs(upper - corner), abs(left - corner), abs(left + upper - 2 * corner)
        nearest = min(by_left, by_upper, by_corner)
        guess = left if by_left == nearest else upper if by_upper == nearest else corner
        row[i] = (row[i] + guess) & 255
    return row


def _error(reason: str) -> DecodeError:
    return DecodeError("message", "PNG", reason)
