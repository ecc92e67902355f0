"""Defines the kinds of values that the models of topics, services and actions share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final

from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, PlainValidator, WithJsonSchema

from ropeway.errors import InvalidName, InvalidTypeName
from ropeway.gateway.config.fields import below
from ropeway.gateway.config.suggest import one_of, show, unknown_key
from ropeway.graph.base import resolve_name
from ropeway.limits import FRAME_PREFIX_CHARACTERS
from ropeway.qos import QoS
from ropeway.types.definition import canonical_name

__all__ = [
    "ENCODINGS",
    "PRIORITIES",
    "Encoding",
    "FramePrefix",
    "IsRaw",
    "Name",
    "Namespace",
    "Priority",
    "Profile",
    "Seconds",
    "TopicTypeName",
    "type_of",
]

ENCODINGS: Final = ("auto", "none", "png", "cbor", "cbor-raw", "zip", "rawzip", "zstd")
POLICIES: Final = ("reliability", "durability", "history", "depth", "deadline", "lifespan")
PRIORITIES: Final[Mapping[str, int]] = {"command": 0, "default": 4, "bulk": 7}
_A: Final = {"topic": "a topic", "service": "a service", "action": "an action"}
_INTERFACE: Final = {"topic": "msg", "service": "srv", "action": "action"}


def _name(value: str) -> str:
    try:
        resolve_name(value)
    except InvalidName as error:
        raise ValueError(f"expected a ROS name such as /camera/image, got {show(value)}: {error.reason}") from error
    return value


def _namespace(value: str) -> str:
    return "/" if value in ("", "/") else resolve_name(_name(value.removesuffix("/")))


def type_of(kind: str) -> AfterValidator:
    """Return what checks the name of a type: of a topic, a service or an action."""
    middle = _INTERFACE[kind]

    def check(value: str) -> str:
        wanted = ValueError(f"expected the type of {_A[kind]}, pkg/{middle}/Name, got {show(value)}")
        try:
            full = canonical_name(value, middle)
        except InvalidTypeName:
            raise wanted from None
        if full.split("/")[1] != middle:
            raise wanted
        return full

    return AfterValidator(check)


def _encoding(value: str) -> str:
    if value not in ENCODINGS:
        raise ValueError(one_of(value, ENCODINGS))
    return value


def _priority(value: object) -> object:
    if isinstance(value, str):
        if value not in PRIORITIES:
            raise ValueError(f"{one_of(value, PRIORITIES)} (or a number from 0, sent first, to 7)")
        return PRIORITIES[value]
    return value


def _israw(value: object) -> bool:
    return bool(value) and not (isinstance(value, str) and value.lower() == "false")


def _qos(value: object) -> QoS | None:
    if value is None or isinstance(value, QoS):
        return value
    if not isinstance(value, Mapping):
        raise ValueError('expected an object such as {"reliability": "best_effort"}')
    for key in value:
        if key not in POLICIES:
            raise below((str(key),), unknown_key(key, POLICIES))
    return QoS.parse(value)


Name = Annotated[str, AfterValidator(_name)]
Namespace = Annotated[str, AfterValidator(_namespace)]
Encoding = Annotated[str, AfterValidator(_encoding), WithJsonSchema({"enum": list(ENCODINGS)})]
Priority = Annotated[
    int,
    Field(ge=0, le=7),
    BeforeValidator(_priority),
    WithJsonSchema({"anyOf": [{"type": "integer", "minimum": 0, "maximum": 7}, {"enum": list(PRIORITIES)}]}),
]
IsRaw = Annotated[bool, BeforeValidator(_israw), WithJsonSchema({})]
Profile = Annotated[
    QoS | None,
    PlainValidator(_qos),
    PlainSerializer(lambda qos: qos and qos.to_json()),
    WithJsonSchema(
        {
            "type": "object",
            "additionalProperties": False,
            "properties": {
                "history": {"enum": ["keep_last", "keep_all"]},
                "depth": {"type": "integer", "minimum": 0},
                "reliability": {"enum": ["reliable", "best_effort", "best_available"]},
                "durability": {"enum": ["volatile", "transient_local", "best_available"]},
                "deadline": {"$ref": "#/$defs/Duration"},
                "lifespan": {"$ref": "#/$defs/Duration"},
            },
        }
    ),
]
Seconds = Annotated[float, Field(gt=0, allow_inf_nan=False)]
FramePrefix = Annotated[str, Field(pattern=rf"^([^\s/]\S{{0,{FRAME_PREFIX_CHARACTERS - 1}}})?$")]


TopicTypeName = Annotated[str, type_of("topic")]
