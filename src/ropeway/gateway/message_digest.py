"""Makes something small of a message that may be megabytes: its fields, long ones cut, and a picture of an image."""

from __future__ import annotations

import base64
import math
from typing import Any, Final

from ropeway.errors import DecodeError
from ropeway.gateway.thumbnail import thumbnail
from ropeway.graph.base import Sample
from ropeway.limits import DIGEST_TEXT_CHARACTERS, DIGEST_VALUES, PICTURE_BYTES
from ropeway.types import TypeRegistry

__all__ = ["digest"]

_ITEMS: Final = 32
"""Elements of an array that are shown: the first ones."""


def digest(registry: TypeRegistry, sample: Sample) -> dict[str, Any]:
    """Return ``value`` with the fields of a message, and ``picture`` where it is an image; or ``error``."""
    try:
        message = registry.codec(sample.type).decode(sample.payload)
    except DecodeError as error:
        return {"error": str(error)}
    found: dict[str, Any] = {"value": _Cut().shown(message)}
    picture = _picture(sample.type, message)
    if picture is not None:
        media_type, data = picture
        found["picture"] = {"media_type": media_type, "base64": base64.b64encode(data).decode()}
    return found


def _picture(type: str, message: dict[str, Any]) -> tuple[str, bytes] | None:
    if type == "sensor_msgs/msg/Image":
        return thumbnail(message)
    if type == "sensor_msgs/msg/CompressedImage":
        data = bytes(message["data"])
        kind = "image/png" if data[:4] == b"\x89PNG" else "image/jpeg" if data[:2] == b"\xff\xd8" else ""
        return (kind, data) if kind and len(data) <= PICTURE_BYTES else None
    return None


class _Cut:
    """Turns a decoded message into JSON of at most ``DIGEST_VALUES`` values."""

    def __init__(self) -> None:
        self._left = DIGEST_VALUES

    def shown(self, value: Any) -> Any:
        self._left -= 1
        if self._left < 0:
            return "…"
        if isinstance(value, dict):
            return {key: self.shown(item) for key, item in value.items()}
        if isinstance(value, str):
            return value if len(value) <= DIGEST_TEXT_CHARACTERS else value[:DIGEST_TEXT_CHARACTERS] + "…"
        if isinstance(value, float):
            return value if math.isfinite(value) else str(value)
        if isinstance(value, bool | int) or value is None:
            return value
        if hasattr(value, "__len__"):
            return self._array(value)
        return self.shown(value.item()) if hasattr(value, "item") else str(value)

    def _array(self, value: Any) -> list[Any]:
        kept = value[:_ITEMS]
        items = kept.tolist() if hasattr(kept, "tolist") else list(kept)
        shown = [self.shown(item) for item in items]
        return [*shown, f"… {len(value)} in all"] if len(value) > _ITEMS else shown
