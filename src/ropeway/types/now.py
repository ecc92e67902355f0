"""Fills in the time if a peer leaves it to the server: headers without stamp, and the Time ``"now"``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ropeway.types.definition import ROS1_TIMES, TIMES, Definition

__all__ = ["replace_now", "stamp_header"]


def stamp_header(value: Any, now_ns: Callable[[], int]) -> Any:
    """Return ``value``, a message with a field ``header``, after stamping that header if it has no stamp."""
    if not isinstance(value, Mapping):
        return value
    header = value.get("header", {})
    if not isinstance(header, Mapping) or "stamp" in header:
        return value
    return {**value, "header": {**header, "stamp": _time(now_ns())}}


def replace_now(name: str, value: Any, definition: Callable[[str], Definition], now_ns: int) -> Any:
    """Return ``value``, a message of type ``name``, with ``now_ns`` in place of every Time that is ``"now"``.

    Gives ``value`` itself where there is none; what does not look like the message is left as it is.
    """
    if name in (TIMES[0], ROS1_TIMES[0]) and isinstance(value, str) and value == "now":
        return _time(now_ns)
    if not isinstance(value, Mapping) or name in TIMES or name in ROS1_TIMES:
        return value
    made = {}
    for field in definition(name).wire_fields:
        type, inner = field.type, value.get(field.name)
        if not type.is_message:
            continue
        if type.kind == "scalar":
            changed = replace_now(type.base, inner, definition, now_ns)
        elif isinstance(inner, list):
            changed = [replace_now(type.base, item, definition, now_ns) for item in inner]
            if all(a is b for a, b in zip(inner, changed, strict=True)):
                continue
        else:
            continue
        if changed is not inner:
            made[field.name] = changed
    return {**value, **made} if made else value


def _time(now_ns: int) -> dict[str, int]:
    return {"sec": now_ns // 1_000_000_000, "nanosec": now_ns % 1_000_000_000}
