"""Locates the array in the CDR of a message that a filter can make smaller.

Only the few fields on the way to it are read. Nothing here must be right for a message to come back whole: a wrong
guess only costs size.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeAlias

__all__ = [
    "BYTES",
    "CONSTANT",
    "GREEN",
    "MAX_STEP",
    "MIN_WIDTH",
    "NUMBERS",
    "RECORDS",
    "UPPER",
    "Array",
    "filtered",
    "find",
]

Data: TypeAlias = bytes | bytearray | memoryview

BYTES: Final = 2
NUMBERS: Final = 3
RECORDS: Final = 4

GREEN: Final = 1
"""Flag: channel 1 was taken off channels 0 and 2."""
UPPER: Final = 2
"""Flag: the upper neighbour's difference was taken off as well."""
MIN_WIDTH: Final = 64
"""Elements of a row with the flag ``UPPER``; bounds the loops over rows by the size of the data."""
CONSTANT: Final = 2
"""Column mode: all records have the same value."""

MAX_STEP: Final = 256
"""Bytes of a record."""

_MIN_COUNT: Final = 256  # elements; below that the planes' own headers cost more than a filter gains


@dataclass(frozen=True, slots=True)
class Array:
    """An array of ``count`` elements from byte ``start`` on, for the filter ``BYTES``, ``NUMBERS`` or ``RECORDS``.

    ``width`` is the number of elements in a row, for ``RECORDS`` the bytes of a record. ``green``: the second of
    the ``channels`` is green, between red and blue.
    """

    filter: int
    start: int
    count: int
    channels: int = 1
    width: int = 0
    green: bool = False

    @property
    def element_bytes(self) -> int:
        """The size of one element."""
        return (self.channels, 2, self.width)[self.filter - BYTES]

    @property
    def length(self) -> int:
        """The size of the whole array in bytes."""
        return self.count * self.element_bytes


def filtered(type: str) -> bool:
    """Return whether messages of a type may have an array that a filter makes smaller."""
    return type in _FINDERS


def find(payload: Data, type: str) -> Array | None:
    """Return the array of a payload of this message type (``pkg/msg/Name``), ``None`` if there is nothing to filter."""
    finder = _FINDERS.get(type)
    return finder(payload) if finder is not None else None


_HEADER_STAMP_END: Final = 12  # the CDR header and a std_msgs/Header's stamp
_U32_1: Final = struct.Struct("<I")
_U32_2: Final = struct.Struct("<II")
_U32_3: Final = struct.Struct("<III")

_CHANNELS: Final[dict[bytes, tuple[int, bool]]] = {
    # what a pixel is made of, and whether channel 1 is green
    b"mono8": (1, False),
    b"8UC1": (1, False),
    b"8SC1": (1, False),
    b"8UC2": (2, False),
    b"8UC3": (3, True),
    b"8UC4": (4, True),
    b"rgb8": (3, True),
    b"bgr8": (3, True),
    b"rgba8": (4, True),
    b"bgra8": (4, True),
    # two columns repeat: the nearest pixel of the same colour is two away
    b"bayer_rggb8": (2, False),
    b"bayer_bggr8": (2, False),
    b"bayer_gbrg8": (2, False),
    b"bayer_grbg8": (2, False),
    # two pixels share their colour: luma, U, luma, V
    b"yuv422": (4, False),
    b"yuv422_yuy2": (4, False),
    b"uyvy": (4, False),
    b"yuyv": (4, False),
}
_NUMBERS_16: Final = frozenset((b"mono16", b"16UC1", b"16SC1"))
_NUMBERS_32: Final = frozenset((b"32FC1", b"32SC1"))


def _aligned(offset: int) -> int:
    return (offset + 3) & ~3


def _after_string(payload: Data, offset: int) -> int:
    (length,) = _U32_1.unpack_from(payload, offset)
    return _aligned(offset + 4 + int(length))


def _find_image(payload: Data) -> Array | None:
    """Return the pixels of a sensor_msgs/Image."""
    try:
        offset = _after_string(payload, _HEADER_STAMP_END)  # frame_id
        _, _, length = _U32_3.unpack_from(payload, offset)  # height, width, length of the encoding with its NUL
        end = offset + 12 + length
        encoding = bytes(payload[offset + 12 : end - 1]) if length <= 32 else b""
        big_endian = payload[end]
        step, size = _U32_2.unpack_from(payload, _aligned(end + 1))
    except (struct.error, IndexError):
        return None
    start = _aligned(end + 1) + 8
    if start + size > len(payload):
        return None
    if encoding in _CHANNELS:
        channels, green = _CHANNELS[encoding]
        array = Array(BYTES, start, size // channels, channels, step // channels, green)
    elif encoding in _NUMBERS_16 and not big_endian:
        array = Array(NUMBERS, start, size // 2, width=step // 2)
    elif encoding in _NUMBERS_32:
        array = Array(RECORDS, start, size // 4, width=4)
    else:
        return None
    return array if array.count >= _MIN_COUNT else None


def _find_cloud(payload: Data) -> Array | None:
    """Return the points of a sensor_msgs/PointCloud2."""
    try:
        offset = _after_string(payload, _HEADER_STAMP_END)  # frame_id
        _, _, fields = _U32_3.unpack_from(payload, offset)  # height, width, number of fields
        if fields > MAX_STEP:
            return None
        offset += 12
        for _ in range(fields):
            offset = _aligned(_after_string(payload, offset) + 5) + 4  # name, offset, datatype, count
        offset = _aligned(offset + 1)  # is_bigendian
        step, _, size = _U32_3.unpack_from(payload, offset)  # point_step, row_step, length of the data
    except (struct.error, IndexError):
        return None
    start = offset + 12
    if start + size > len(payload) or not 4 <= step <= MAX_STEP or size // step < _MIN_COUNT:
        return None
    return Array(RECORDS, start, size // step, width=step)


_FINDERS: Final[dict[str, Callable[[Data], Array | None]]] = {
    "sensor_msgs/msg/Image": _find_image,
    "sensor_msgs/msg/PointCloud2": _find_cloud,
}
