"""The ``png`` encoding: as bytes, and with checksums and compression put right so that rows are reached."""

from __future__ import annotations

import struct
import zlib
from typing import Final

from fuzz.target import Target
from ropeway.errors import DecodeError, MessageTooBig
from ropeway.networks.rosbridge.protocol import png

__all__ = ["TARGETS"]

_LIMIT_BYTES: Final = 1 << 20
_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"


def _png(data: bytes) -> None:
    assert len(png.unpack(data, limit_bytes=_LIMIT_BYTES)) <= _LIMIT_BYTES + len(data)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def _rows(data: bytes) -> None:
    """Width and height in two bytes each, then the rows with their filters."""
    width, height = struct.unpack(">HH", data[:4].ljust(4, b"\1"))
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = zlib.compress(data[4:], 1)
    half = len(pixels) // 2
    parts = (b"IHDR", header), (b"IDAT", pixels[:half]), (b"tEXt", b"x"), (b"IDAT", pixels[half:]), (b"IEND", b"")
    _png(_SIGNATURE + b"".join(_chunk(*part) for part in parts))


def _row_seeds() -> list[bytes]:
    return [struct.pack(">HH", 3, 5) + b"".join(bytes((filter,)) + bytes(range(9)) for filter in range(5))]


TARGETS: Final = {
    "png": Target(
        _png, (DecodeError, MessageTooBig), lambda: [png.pack(b"{}"), png.pack(b"x" * 100)], (b"IDAT", b"IEND")
    ),
    "png-rows": Target(_rows, (DecodeError, MessageTooBig), _row_seeds),
}
