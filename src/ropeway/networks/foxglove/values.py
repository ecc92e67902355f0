"""Writes the values of parameters for viewers, and reads theirs.

JSON does not tell 5.0 from 5, nor bytes from a text, so a value may come with a type: ``float64``, ``float64_array``,
or ``byte_array``, which is base64.
"""

from __future__ import annotations

import base64
import binascii
import math
from typing import TYPE_CHECKING, Any

from ropeway.errors import ValueMismatch
from ropeway.graph.parameters import type_of

if TYPE_CHECKING:
    from ropeway.graph.parameters import ParameterValue
    from ropeway.networks.foxglove.wire import GivenParameter

__all__ = ["shown_parameter", "wanted_value"]


def shown_parameter(name: str, value: Any) -> dict[str, Any]:
    """Return a parameter as viewers read it; one that is not set has no value."""
    if value is None:
        return {"name": name}
    if isinstance(value, bytes):
        return {"name": name, "value": base64.b64encode(value).decode(), "type": "byte_array"}
    if isinstance(value, float):
        return {"name": name, "value": _finite(value), "type": "float64"}
    if isinstance(value, list) and value and all(isinstance(item, float) for item in value):
        return {"name": name, "value": [_finite(item) for item in value], "type": "float64_array"}
    return {"name": name, "value": value}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def wanted_value(given: GivenParameter, now: ParameterValue) -> ParameterValue:
    """Return the value that a viewer sets, in the type that it names, or that the parameter has ``now``.

    Raises ``ValueMismatch`` for what no parameter can have.
    """
    value = given.value
    if not given.given:
        return None
    if given.type == "byte_array":
        return _bytes(given.name, value)
    is_list = isinstance(value, list)
    floats = given.type in ("float64", "float64_array") or isinstance(now, float)
    floats = floats or (isinstance(now, list) and any(isinstance(item, float) for item in now))
    if floats and _is_number(value):
        return float(value)
    if is_list and value and all(map(_is_number, value)) and (floats or any(isinstance(n, float) for n in value)):
        return [float(n) for n in value]
    type_of(value)
    return value  # type: ignore[no-any-return]


def _bytes(name: str, value: Any) -> bytes:
    try:
        return base64.b64decode(value, validate=True)
    except (binascii.Error, ValueError, TypeError):
        raise ValueMismatch("rcl_interfaces/msg/ParameterValue", name, f"{name}: bytes are given in base64") from None


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
