"""Reads calls and answers in the form in which gateways send them, with as few steps as there can be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from ropeway.limits import ID_CHARACTERS, NAME_CHARACTERS
from ropeway.networks.rosbridge.protocol.operations import CallService, ServiceResponse

__all__ = ["plain_call", "plain_response"]

_PLAIN_ENCODINGS: Final = ("cbor-raw", "zstd", None)


def plain_call(message: Mapping[Any, Any]) -> CallService | None:
    """Read a call as a gateway sends it, at once; ``None`` for others, which ``ops.parse`` reads and judges."""
    get = message.get
    id, service, type, timeout, note = get("id"), get("service"), get("type"), get("timeout"), get("ropeway")
    compression = get("compression")
    if (
        id.__class__ is str
        and len(id) <= ID_CHARACTERS
        and service.__class__ is str
        and len(service) <= NAME_CHARACTERS
        and (type is None or (type.__class__ is str and len(type) <= NAME_CHARACTERS))
        and timeout.__class__ is float
        and 0.0 < timeout < math.inf
        and note.__class__ is dict
        and compression in _PLAIN_ENCODINGS
        and "fragment_size" not in message
    ):
        return CallService(
            service=service,
            args=get("args"),
            id=id,
            type=type,
            timeout=timeout,
            compression=compression,
            ropeway=note,
        )
    return None


def plain_response(message: Mapping[Any, Any]) -> ServiceResponse | None:
    """Read an answer as a gateway sends it, at once; ``None`` for others, which ``ops.parse`` reads."""
    get = message.get
    id, service, result, compression = get("id"), get("service"), get("result"), get("compression")
    if (
        id.__class__ is str
        and len(id) <= ID_CHARACTERS
        and service.__class__ is str
        and len(service) <= NAME_CHARACTERS
        and result is True
        and compression in _PLAIN_ENCODINGS
        and "ropeway" not in message
    ):
        return ServiceResponse(service=service, values=get("values"), result=True, id=id, compression=compression)
    return None
