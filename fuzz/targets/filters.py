"""The ``zstd`` body: as bytes, with planes that unpack, and on the way out."""

from __future__ import annotations

import struct
from typing import Final

import zstandard

from fuzz.target import Target
from fuzz.targets.types import CODECS
from ropeway.delivery.compression import filters
from ropeway.errors import DecodeError, MessageTooBig

__all__ = ["TARGETS"]

_LIMIT_BYTES: Final = 1 << 20
_HEADER_BYTES: Final = struct.calcsize("<BBBxIIII")
_COMPRESSOR: Final = zstandard.ZstdCompressor(level=1)
_TYPES: Final = ("sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2", "std_msgs/msg/String")


def _zstd(data: bytes) -> None:
    assert len(filters.decode(data, _LIMIT_BYTES)) <= _LIMIT_BYTES


def _planes(data: bytes) -> None:
    """A header and what follows it up to a mark as they are, then planes of as many elements as the header says."""
    head, _, seed = data.partition(b"planes")
    head = head.ljust(_HEADER_BYTES, b"\0")
    (count,) = struct.unpack_from("<I", head, _HEADER_BYTES - 4)
    pieces = [head]
    if count <= 1 << 16:
        content = (seed or b"\0") * (count // max(len(seed), 1) + 1)
        frame = _COMPRESSOR.compress(content[:count])
        number = 1 + seed[0] % 8 if seed else 4
        pieces += [struct.pack("<I", len(frame)) + frame] * number
    _zstd(b"".join(pieces))


def _filtered(data: bytes) -> None:
    """Whatever is filtered comes back as it was."""
    type, payload = _TYPES[data[0] % len(_TYPES)] if data else "", data[1:]
    assert filters.decode(filters.encode(payload, type)) == payload


def _payloads() -> list[bytes]:
    codecs = {codec.type: codec for codec in CODECS}
    image = {"height": 20, "width": 20, "encoding": "rgb8", "step": 60, "data": bytes(range(240)) * 5}
    wide = {**image, "encoding": "mono16", "step": 40, "data": bytes(range(160)) * 5}
    field = {"name": "x", "datatype": 7, "count": 1}
    cloud = {"height": 1, "width": 300, "point_step": 16, "row_step": 4800, "fields": [field], "data": bytes(4800)}
    made = [(0, codecs[_TYPES[0]].encode(value)) for value in (image, wide)]
    made += [(1, codecs[_TYPES[1]].encode(cloud)), (2, codecs[_TYPES[2]].encode({"data": "x" * 300}))]
    return [bytes((number,)) + payload for number, payload in made]


def _bodies() -> list[bytes]:
    return [filters.encode(payload[1:], _TYPES[payload[0]]) for payload in _payloads()]


def _headers() -> list[bytes]:
    shapes = ((2, 3, 3, 20, 400), (2, 1, 2, 20, 400), (3, 1, 2, 20, 400), (3, 4, 2, 1600, 400), (4, 1, 0, 16, 300))
    made = []
    for filter, channels, flags, width, count in shapes:
        modes = bytes((0, 1, 2, 0)) if filter == 4 else b""
        head = struct.pack("<BBBxIIII", filter, channels, flags, 0, 0, width, count)
        made.append(head + modes + bytes(8 if filter == 4 else 0) + b"planes\3\1\2")
    return made


TARGETS: Final = {
    "zstd": Target(_zstd, (DecodeError, MessageTooBig), _bodies),
    "planes": Target(_planes, (DecodeError, MessageTooBig), _headers, (b"planes",), longest_bytes=512),
    "filtered": Target(_filtered, (), _payloads),
}
