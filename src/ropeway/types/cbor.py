"""CBOR as rosbridge and rosgw write it: floats always in 64 bits.

``cbor2`` shortens NaN and infinity to half precision, which the decoders of web pages do not know. ``MessageCodec``
therefore gives them as ``WideFloat``, and ``dumps`` writes those in full.
"""

from __future__ import annotations

import math
import struct
from typing import Any, Final

import cbor2

__all__ = ["WideFloat", "dumps", "plain_numbers", "wide"]

_HALF: Final = b"\xf9"
_DOUBLE: Final = struct.Struct(">cd").pack


class WideFloat(float):
    """A float that is not finite. Only ``dumps`` treats it otherwise than a plain float."""

    __slots__ = ()


def wide(value: float) -> float:
    """Return ``value``, as a ``WideFloat`` if it is not finite."""
    return value if math.isfinite(value) else WideFloat(value)


def plain_numbers(raw: bytes, start: int, count: int, code: str) -> list[Any]:
    """Return ``count`` little-endian numbers as a list."""
    found = list(struct.unpack_from(f"<{count}{code}", raw, start))
    return list(map(wide, found)) if code in "fd" and not math.isfinite(sum(found)) else found


def dumps(value: Any) -> bytes:
    """Return the CBOR of ``value``, which may hold anything that ``MessageCodec.cbor`` and ``rosgw`` return."""
    coded = cbor2.dumps(value)
    # the plain way is twice as fast, so the other is taken only where a half float may be
    return cbor2.dumps(value, encoders=_ENCODERS) if _HALF in coded else coded


def _encode(encoder: Any, value: float) -> None:
    encoder.write(_DOUBLE(b"\xfb", value))


_ENCODERS: Final[dict[type, Any]] = {WideFloat: _encode}
