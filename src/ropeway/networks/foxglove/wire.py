"""The frames of the Foxglove WebSocket protocol: reads those of a viewer, and makes those of a server.

What a viewer sends is checked here as far as its shape goes, so that nothing behind has to look again. All numbers in
binary frames are little-endian.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import orjson

from ropeway.errors import InvalidFrame, InvalidOperation
from ropeway.limits import (
    ASSET_URI_CHARACTERS,
    DEFINITION_CHARACTERS,
    ID_CHARACTERS,
    NAME_CHARACTERS,
    TYPE_NAME_CHARACTERS,
    VIEWER_ITEMS_PER_OPERATION,
    VIEWER_PARAMETER_CHARACTERS,
)
from ropeway.types.untrusted import json_loads

__all__ = [
    "MESSAGE_HEADER_BYTES",
    "ChannelOffer",
    "FetchAsset",
    "GetParameters",
    "GivenParameter",
    "LeaveChannels",
    "OfferChannels",
    "ReadChannels",
    "SetParameters",
    "ViewerCall",
    "ViewerMessage",
    "ViewerOperation",
    "WatchGraph",
    "WatchParameters",
    "WithdrawChannels",
    "asset_error",
    "asset_found",
    "dumps",
    "message_prefix",
    "read_binary",
    "read_text",
    "service_response",
    "time_frame",
]

MESSAGE_HEADER_BYTES: Final = 13
"""The bytes of a frame before the message in it: the opcode, the subscription and the time."""

_MOST: Final = 2**32 - 1
_ENCODING_BYTES: Final = 64  # of the name of an encoding
_MESSAGE: Final = struct.Struct("<BI")
_TIME: Final = struct.Struct("<BQ")
_CALL: Final = struct.Struct("<BIII")
_ASSET: Final = struct.Struct("<BIBI")
_FROM_VIEWER: Final = {"message data": 1, "a service call": 2}


@dataclass(frozen=True, slots=True)
class ReadChannels:
    """Reads channels: pairs of the id that the viewer gives the subscription, and the channel's."""

    pairs: tuple[tuple[int, int], ...]
    op: str = "subscribe"


@dataclass(frozen=True, slots=True)
class LeaveChannels:
    """Reads channels no more; ``ids`` are those of the subscriptions."""

    ids: tuple[int, ...]
    op: str = "unsubscribe"


@dataclass(frozen=True, slots=True)
class ChannelOffer:
    """A channel on which the viewer will publish, under its own ``id``."""

    id: int
    topic: str
    encoding: str
    type: str
    schema: str
    schema_encoding: str


@dataclass(frozen=True, slots=True)
class OfferChannels:
    """Publishes on channels from now on."""

    channels: tuple[ChannelOffer, ...]
    op: str = "advertise"


@dataclass(frozen=True, slots=True)
class WithdrawChannels:
    """Publishes on channels no more."""

    ids: tuple[int, ...]
    op: str = "unadvertise"


@dataclass(frozen=True, slots=True)
class GetParameters:
    """Asks for parameters, all of them where no name is given; the answer carries ``id``."""

    names: tuple[str, ...]
    id: str | None
    op: str = "getParameters"


@dataclass(frozen=True, slots=True)
class GivenParameter:
    """A parameter as a viewer sets it: ``type`` says what JSON cannot, ``given`` is false where it is to be unset."""

    name: str
    value: Any
    type: str
    given: bool


@dataclass(frozen=True, slots=True)
class SetParameters:
    """Sets parameters; the answer carries ``id`` and is left out without one."""

    parameters: tuple[GivenParameter, ...]
    id: str | None
    op: str = "setParameters"


@dataclass(frozen=True, slots=True)
class WatchParameters:
    """Begins (``on``) or ends to be told of changes of parameters."""

    names: tuple[str, ...]
    on: bool
    op: str = "subscribeParameterUpdates"


@dataclass(frozen=True, slots=True)
class WatchGraph:
    """Begins (``on``) or ends to be told of changes of the graph."""

    on: bool
    op: str = "subscribeConnectionGraph"


@dataclass(frozen=True, slots=True)
class FetchAsset:
    """Asks for a file."""

    uri: str
    request_id: int
    op: str = "fetchAsset"


@dataclass(frozen=True, slots=True)
class ViewerMessage:
    """A message that the viewer publishes on its channel."""

    channel: int
    data: bytes
    op: str = "message data"


@dataclass(frozen=True, slots=True)
class ViewerCall:
    """A call of a service; ``call`` names it in the answer."""

    service: int
    call: int
    encoding: str
    data: bytes
    op: str = "service call"


ViewerOperation = (
    ReadChannels
    | LeaveChannels
    | OfferChannels
    | WithdrawChannels
    | GetParameters
    | SetParameters
    | WatchParameters
    | WatchGraph
    | FetchAsset
    | ViewerMessage
    | ViewerCall
)
"""Everything that a viewer may send."""


# ── what a viewer sends ────────────────────────────────────────────────────────────────────────────────────────────


def read_binary(data: bytes | memoryview) -> ViewerMessage | ViewerCall:
    """Read a binary frame of a viewer. Raises ``InvalidFrame``."""
    size = len(data)
    if not size:
        raise InvalidFrame("an empty binary frame came; its first byte says what it is", size)
    opcode = data[0]
    if opcode == 1:
        if size < _MESSAGE.size:
            raise InvalidFrame(
                f"message data needs {_MESSAGE.size} bytes before the message, and came with {size}", size
            )
        return ViewerMessage(_MESSAGE.unpack_from(data)[1], bytes(data[_MESSAGE.size :]))
    if opcode == 2:
        if size < _CALL.size:
            raise InvalidFrame(
                f"a service call needs {_CALL.size} bytes before its encoding, and came with {size}", size
            )
        _, service, call, length = _CALL.unpack_from(data)
        begin = _CALL.size + length
        if length > _ENCODING_BYTES or begin > size:
            raise InvalidFrame(f"a service call names an encoding of {length} bytes, and {size} came in all", size)
        try:
            encoding = str(data[_CALL.size : begin], "utf-8")
        except UnicodeDecodeError:
            raise InvalidFrame("the encoding of a service call is not a text", size) from None
        return ViewerCall(service, call, encoding, bytes(data[begin:]))
    known = ", ".join(f"{number} ({name})" for name, number in _FROM_VIEWER.items())
    raise InvalidFrame(f"the opcode {opcode} of a binary frame is not known; known are {known}", size)


def read_text(data: bytes) -> ViewerOperation:
    """Read a text frame of a viewer. Raises ``InvalidFrame`` and ``InvalidOperation``."""
    message = json_loads(data)
    if not isinstance(message, dict):
        raise InvalidFrame("an operation is a JSON object", len(data))
    op = message.get("op")
    read = _READERS.get(op) if isinstance(op, str) else None
    if read is None:
        raise InvalidOperation("operation", f"op {_shown(op)} is not known here; known are {', '.join(_READERS)}")
    return read(message)


def _subscribe(message: Mapping[str, Any]) -> ReadChannels:
    items = _list(message, "subscriptions", dict)
    return ReadChannels(
        tuple((_number(item, "id", "subscribe"), _number(item, "channelId", "subscribe")) for item in items)
    )


def _unsubscribe(message: Mapping[str, Any]) -> LeaveChannels:
    return LeaveChannels(_numbers(message, "subscriptionIds"))


def _advertise(message: Mapping[str, Any]) -> OfferChannels:
    return OfferChannels(tuple(_offer(item) for item in _list(message, "channels", dict)))


def _offer(item: Mapping[str, Any]) -> ChannelOffer:
    return ChannelOffer(
        _number(item, "id", "advertise"),
        _text(item, "topic", "advertise", NAME_CHARACTERS),
        _text(item, "encoding", "advertise", _ENCODING_BYTES),
        _text(item, "schemaName", "advertise", TYPE_NAME_CHARACTERS),
        _text(item, "schema", "advertise", DEFINITION_CHARACTERS, default=""),
        _text(item, "schemaEncoding", "advertise", _ENCODING_BYTES, default=""),
    )


def _unadvertise(message: Mapping[str, Any]) -> WithdrawChannels:
    return WithdrawChannels(_numbers(message, "channelIds"))


def _get_parameters(message: Mapping[str, Any]) -> GetParameters:
    return GetParameters(_names(message), _id(message))


def _set_parameters(message: Mapping[str, Any]) -> SetParameters:
    items = _list(message, "parameters", dict)
    return SetParameters(tuple(_given(item) for item in items), _id(message))


def _given(item: Mapping[str, Any]) -> GivenParameter:
    name = _text(item, "name", "setParameters", VIEWER_PARAMETER_CHARACTERS)
    type = _text(item, "type", "setParameters", _ENCODING_BYTES, default="")
    if type not in ("", "byte_array", "float64", "float64_array"):
        raise InvalidOperation("setParameters", f"the type {_shown(type)} of {name} is not known")
    value = item.get("value")
    return GivenParameter(name, value, type, value is not None)


def _watch_parameters(op: Literal["subscribeParameterUpdates", "unsubscribeParameterUpdates"], on: bool) -> _Reader:
    return lambda message: WatchParameters(_names(message), on, op)


def _watch_graph(op: Literal["subscribeConnectionGraph", "unsubscribeConnectionGraph"], on: bool) -> _Reader:
    return lambda message: WatchGraph(on, op)


def _fetch_asset(message: Mapping[str, Any]) -> FetchAsset:
    return FetchAsset(
        _text(message, "uri", "fetchAsset", ASSET_URI_CHARACTERS), _number(message, "requestId", "fetchAsset")
    )


_Reader = Callable[[Mapping[str, Any]], ViewerOperation]
_READERS: Final[Mapping[str, _Reader]] = {
    "subscribe": _subscribe,
    "unsubscribe": _unsubscribe,
    "advertise": _advertise,
    "unadvertise": _unadvertise,
    "getParameters": _get_parameters,
    "setParameters": _set_parameters,
    "subscribeParameterUpdates": _watch_parameters("subscribeParameterUpdates", True),
    "unsubscribeParameterUpdates": _watch_parameters("unsubscribeParameterUpdates", False),
    "subscribeConnectionGraph": _watch_graph("subscribeConnectionGraph", True),
    "unsubscribeConnectionGraph": _watch_graph("unsubscribeConnectionGraph", False),
    "fetchAsset": _fetch_asset,
}


def _list(message: Mapping[str, Any], key: str, kind: type) -> list[Any]:
    found = message.get(key)
    op = str(message["op"])
    if not isinstance(found, list):
        raise InvalidOperation(op, f"{key} is to be a list")
    if len(found) > VIEWER_ITEMS_PER_OPERATION:
        raise InvalidOperation(op, f"{key} has {len(found)} items; at most {VIEWER_ITEMS_PER_OPERATION} are taken")
    for item in found:
        if not isinstance(item, kind):
            raise InvalidOperation(op, f"{key} has {_shown(item)} among its items, which are of another kind")
    return found


def _numbers(message: Mapping[str, Any], key: str) -> tuple[int, ...]:
    found = _list(message, key, int)
    return tuple(_checked(value, key, str(message["op"])) for value in found)


def _number(item: Mapping[str, Any], key: str, op: str) -> int:
    return _checked(item.get(key), key, op)


def _checked(value: Any, key: str, op: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _MOST:
        raise InvalidOperation(op, f"{key} is to be a whole number of 32 bits, not {_shown(value)}")
    return value


def _names(message: Mapping[str, Any]) -> tuple[str, ...]:
    found = _list(message, "parameterNames", str)
    longest = max(map(len, found), default=0)
    if longest > VIEWER_PARAMETER_CHARACTERS:
        raise InvalidOperation(
            str(message["op"]),
            f"a name has {longest} characters; the longest of a parameter has {VIEWER_PARAMETER_CHARACTERS}",
        )
    return tuple(dict.fromkeys(found))


def _id(message: Mapping[str, Any]) -> str | None:
    if message.get("id") is None:
        return None
    return _text(message, "id", str(message["op"]), ID_CHARACTERS)


def _text(item: Mapping[str, Any], key: str, op: str, most: int, *, default: str | None = None) -> str:
    value = item.get(key)
    if value is None and default is not None:
        return default
    if not isinstance(value, str):
        raise InvalidOperation(op, f"{key} is to be a text, not {_shown(value)}")
    if len(value) > most:
        raise InvalidOperation(op, f"{key} has {len(value)} characters; at most {most} are taken")
    return value


def _shown(value: object) -> str:
    return repr(value) if isinstance(value, (bool, float, type(None))) else repr(str(value)[:80])


# ── what a server sends ────────────────────────────────────────────────────────────────────────────────────────────


def dumps(message: Mapping[str, Any]) -> bytes:
    """Write an operation of the server; ``orjson.Fragment`` in it is taken as it is."""
    return orjson.dumps(message)


def message_prefix(subscription: int) -> bytes:
    """Return the bytes of message data before its time, the same for every message of a subscription."""
    return _MESSAGE.pack(1, subscription)


def time_frame(time_ns: int) -> bytes:
    """Return the frame that tells the time of a simulation."""
    return _TIME.pack(2, time_ns)


def service_response(service: int, call: int, encoding: str, payload: bytes) -> bytes:
    """Return the frame with the answer of a service."""
    name = encoding.encode()
    return b"".join((_CALL.pack(3, service, call, len(name)), name, payload))


def asset_found(request: int, content: bytes) -> bytes:
    """Return the frame with a file."""
    return b"".join((_ASSET.pack(4, request, 0, 0), content))


def asset_error(request: int, text: str) -> bytes:
    """Return the frame that says why there is no such file."""
    said = text.encode()
    return b"".join((_ASSET.pack(4, request, 1, len(said)), said))
