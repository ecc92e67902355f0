"""Provides the functions that generated code calls for values that are not in their plainest form.

Readers take pieces of a message out of its bytes; writers bring whatever a JSON or CBOR peer or a program may give
for a field (lists, base64, byte strings, typed arrays, numpy) to the bytes of the field. ``Misfit`` says only that a
value does not fit; ``check`` finds out where and why.
"""

from __future__ import annotations

import math
import struct
import sys
import threading
from array import array
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar

import orjson
import pybase64

__all__ = [
    "Empties",
    "Misfit",
    "Short",
    "base64_text",
    "byte",
    "from_base64",
    "items",
    "json_numbers",
    "mapping",
    "number_packer",
    "octets",
    "read_wide",
    "real",
    "text",
    "time_parts",
    "truth",
    "truths",
    "typed_array",
    "whole",
    "wide",
]

_LITTLE: Final = sys.byteorder == "little"
_SMALL: Final = 32

_Sized = TypeVar("_Sized")


class Misfit(Exception):
    """A value does not fit its field."""


class Short(Exception):
    """The bytes end before the message does, or a length in them is impossible."""


class Empties(threading.local):
    """Counts the elements of one message that take no bytes, which nothing else bounds.

    ``wanted`` tells whether a type has any. Each thread counts the message that it reads.
    """

    def __init__(self, limit: int) -> None:
        self.limit = self.left = limit
        self.wanted = False

    def begin(self) -> None:
        """Begin a message."""
        self.left = self.limit

    def take(self, count: int) -> None:
        """Count elements. Raises ``Short`` above the limit."""
        self.left -= count
        if self.left < 0:
            raise Short(f"more than {self.limit} elements without content")


def base64_text(raw: bytes, start: int, end: int) -> orjson.Fragment:
    """Return a JSON string with the base64 form of ``raw[start:end]``."""
    return orjson.Fragment(b"".join((b'"', pybase64.b64encode(memoryview(raw)[start:end]), b'"')))


def from_base64(value: str) -> bytes:
    """Decode a base64 text; characters outside its alphabet (line ends) are skipped, as rosbridge does."""
    try:
        return pybase64.b64decode(value, validate=True)  # five times faster
    except ValueError:
        return pybase64.b64decode(value)


def json_numbers(raw: bytes, start: int, count: int, code: str) -> Any:
    """Return ``count`` little-endian numbers in a form that orjson writes with full precision; NaN and infinity become
    null.
    """
    if count <= _SMALL:
        return struct.unpack_from(f"<{count}{code}", raw, start)
    import numpy as np

    found = np.frombuffer(raw, "<" + code, count, start)
    return found.astype(np.float64 if code == "f" else found.dtype.newbyteorder("="))


def read_wide(raw: bytes, start: int, count: int) -> str:
    """Read a wstring of ``count`` UTF-16 units, each in four bytes as ROS 2's middlewares send them."""
    units = struct.unpack_from(f"<{count}I", raw, start)
    if units and max(units) > 0xFFFF:
        raise Short("a wstring has a character above U+FFFF")
    return struct.pack(f"<{count}H", *units).decode("utf-16-le", "replace")


def wide(value: Any, bound: int) -> bytes:
    """Return the bytes of a wstring."""
    if not isinstance(value, str):
        raise Misfit
    coded = value.encode("utf-16-le")
    count = len(coded) // 2
    if bound and count > bound:
        raise Misfit
    return struct.pack(f"<{count}I", *struct.unpack(f"<{count}H", coded))


def text(value: Any, bound: int) -> bytes:
    """Return the bytes of a string that is bounded, or not plainly a ``str``."""
    if not isinstance(value, str):
        raise Misfit
    coded = value.encode()
    if bound and len(coded) > bound:
        raise Misfit
    return coded


def real(value: Any) -> float:
    """Convert an int, a bool (rosbridge takes them), ``None`` (NaN) or a numpy number to a float."""
    if value is None:
        return math.nan
    if not (isinstance(value, (int, float)) or _is_numpy(value, "iuf")):
        raise Misfit
    return float(value)


def whole(value: Any) -> int:
    """Convert a numpy number to an int."""
    if not _is_numpy(value, "iu"):
        raise Misfit
    return int(value)


def byte(value: Any) -> int:
    """Convert a ``bytes`` of length one or a numpy number to an octet."""
    if isinstance(value, (bytes, bytearray)) and len(value) == 1:
        return value[0]
    return whole(value)


def truth(value: Any) -> bool:
    """Convert a numpy bool to a bool."""
    if not _is_numpy(value, "b"):
        raise Misfit
    return bool(value)


def truths(value: Any, count: int, limit: int) -> bytes:
    """Return the bytes of a bool array: ``count`` elements (any number if negative), at most ``limit`` if that is not
    0.
    """
    if isinstance(value, (list, tuple)):
        if not all(item is True or item is False for item in value):
            value = [truth(item) if item is not True and item is not False else item for item in value]
        coded = bytes(value)
    elif isinstance(value, (bytes, bytearray, memoryview)):
        coded = bytes(value)
        if coded.strip(b"\0\1"):
            raise Misfit
    elif _is_array(value) and value.dtype.kind == "b":
        coded = value.tobytes()
    else:
        raise Misfit
    return _counted(coded, len(coded), count, limit)


def mapping(value: Any) -> dict[str, Any]:
    """Convert another mapping to a dict."""
    if not isinstance(value, Mapping):
        raise Misfit
    return dict(value)


def items(value: Any, count: int, limit: int) -> Any:
    """Check a list or tuple of ``count`` elements (any number if negative), at most ``limit`` if that is not 0."""
    if not isinstance(value, (list, tuple)):
        raise Misfit
    return _counted(value, len(value), count, limit)


def time_parts(value: Any) -> tuple[int, int]:
    """Return seconds and nanoseconds of a Time or Duration, in ROS 2's or ROS 1's spelling; what is missing is 0."""
    if not isinstance(value, Mapping):
        raise Misfit
    seconds = value["sec"] if "sec" in value else value.get("secs", 0)
    nanoseconds = value["nanosec"] if "nanosec" in value else value.get("nsecs", 0)
    if not value.keys() <= {"sec", "secs", "nanosec", "nsecs"}:
        raise Misfit
    return (
        seconds if seconds.__class__ is int else whole(seconds),
        nanoseconds if nanoseconds.__class__ is int else whole(nanoseconds),
    )


def octets(value: Any, count: int, limit: int) -> bytes:
    """Return the bytes of an array of uint8, char or byte given as bytes, base64, numbers or a typed array."""
    if isinstance(value, bytes):
        coded = value
    elif isinstance(value, str):
        coded = from_base64(value)
    elif isinstance(value, (bytearray, memoryview)):
        coded = bytes(value)
    elif isinstance(value, (list, tuple)):
        try:
            coded = bytes(value)
        except TypeError:
            coded = bytes([item if item.__class__ is int else byte(item) for item in value])
    elif _is_array(value) and value.dtype.kind in "iu":
        coded = value.tobytes() if value.dtype.itemsize == 1 else bytes(value.tolist())
    elif _is_tag(value):
        coded = bytes(typed_array(value).tolist()) if value.tag not in (64, 68) else _tag_bytes(value)
    else:
        raise Misfit
    return _counted(coded, len(coded), count, limit)


def number_packer(code: str) -> Callable[[Any, int, int], bytes]:
    """Make a function that returns the bytes of an array of numbers.

    Its arguments are the value, how many elements it must have (negative: any number) and the most it may have
    (0: no limit).
    """
    size = struct.calcsize(code)
    floating = code in "fd"
    tag = {"b": 72, "h": 77, "i": 78, "q": 79, "H": 69, "I": 70, "Q": 71, "f": 85, "d": 86}[code]

    def pack(value: Any, count: int, limit: int) -> bytes:
        if value.__class__ is list or value.__class__ is tuple:
            coded = from_items(value)
        elif isinstance(value, (bytes, bytearray, memoryview)):
            coded = bytes(value)
        elif _is_array(value):
            coded = from_numpy(value)
        elif _is_tag(value):
            coded = _tag_bytes(value) if value.tag == tag else from_numpy(typed_array(value))
        elif isinstance(value, (list, tuple, array)):
            coded = from_items(list(value))
        else:
            raise Misfit
        if len(coded) % size:
            raise Misfit
        return _counted(coded, len(coded) // size, count, limit)

    def from_items(value: Any) -> bytes:
        try:
            made = array(code, value)
        except TypeError:
            if floating:
                made = array(code, [real(item) if item.__class__ is not float else item for item in value])
            else:
                made = array(code, [whole(item) if item.__class__ is not int else item for item in value])
        if not _LITTLE:
            made.byteswap()
        return made.tobytes()

    def from_numpy(value: Any) -> bytes:
        import numpy as np

        target = np.dtype("<" + code)
        if value.dtype != target:
            if value.dtype.kind not in ("iuf" if floating else "iu"):
                raise Misfit
            if not floating and not np.can_cast(value.dtype, target):
                return from_items(value.ravel().tolist())
            value = value.astype(target)
        made: bytes = value.tobytes()
        return made

    return pack


def typed_array(value: Any) -> Any:
    """Return the numpy array in a typed array of CBOR (RFC 8746), of any byte order and width."""
    import numpy as np

    tag, raw = value.tag, _tag_bytes(value)
    if not isinstance(tag, int) or not 64 <= tag <= 87 or tag == 76:
        raise Misfit
    floating, signed, little, width = tag >> 4 & 1, tag >> 3 & 1, tag >> 2 & 1, tag & 3
    size = 2 << width if floating else 1 << width
    if size > 8:
        raise Misfit
    kind = "f" if floating else "i" if signed else "u"
    return np.frombuffer(raw, f"{'<' if little and size > 1 else '>'}{kind}{size}")


def _counted(value: _Sized, length: int, count: int, limit: int) -> _Sized:
    if (count >= 0 and length != count) or (limit and length > limit):
        raise Misfit
    return value


def _tag_bytes(value: Any) -> bytes:
    if not isinstance(value.value, (bytes, bytearray, memoryview)):
        raise Misfit
    return bytes(value.value)


def _is_numpy(value: Any, kinds: str) -> bool:
    """Return whether ``value`` is a numpy scalar of one of ``kinds``, without importing numpy to find out."""
    kind = getattr(getattr(value, "dtype", None), "kind", "")
    return kind != "" and kind in kinds and getattr(value, "shape", None) == ()


def _is_array(value: Any) -> bool:
    return hasattr(value, "dtype") and hasattr(value, "tobytes")


def _is_tag(value: Any) -> bool:
    return hasattr(value, "tag") and hasattr(value, "value")
