"""Models of the names that a configuration has cross: topics, services and actions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Final, Literal

from pydantic import (
    AfterValidator,
    AliasChoices,
    BeforeValidator,
    Field,
    PlainSerializer,
    PlainValidator,
    WithJsonSchema,
)

from ropeway.errors import InvalidName, InvalidTypeName
from ropeway.gateway.config.fields import Many, Model, Switch, below
from ropeway.gateway.config.overlay_model import METADATA, METADATUM, Metadatum
from ropeway.gateway.config.suggest import one_of, show, unknown_key
from ropeway.graph.base import Delivery, resolve_name
from ropeway.limits import FRAME_PREFIX_CHARACTERS
from ropeway.qos import QoS
from ropeway.types.definition import canonical_name
from ropeway.types.frame_names import FrameNames

__all__ = [
    "ENCODINGS",
    "OPERATIONS",
    "PRIORITIES",
    "ActionItem",
    "BridgedName",
    "CommandSafety",
    "ExpectedTraffic",
    "Name",
    "Namespace",
    "RenamedTopicItem",
    "Seconds",
    "ServiceItem",
    "TopicItem",
    "TopicTypeName",
]

ENCODINGS: Final = ("auto", "none", "png", "cbor", "cbor-raw", "zip", "rawzip", "zstd")
POLICIES: Final = ("reliability", "durability", "history", "depth", "deadline", "lifespan")
PRIORITIES: Final[Mapping[str, int]] = {"command": 0, "default": 4, "bulk": 7}
OPERATIONS: Final[Mapping[str, str]] = {
    "publish": "topic",
    "subscribe": "topic",
    "trans-publish": "topic",
    "expose-service": "service",
    "reserve-service": "service",
    "expose-action": "action",
    "reserve-action": "action",
}
"""Every operation and its class, as ``OpClassOf`` of the paper has it."""

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


def _type_of(kind: str) -> AfterValidator:
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


TopicTypeName = Annotated[str, _type_of("topic")]
CommandMax = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class CommandSafety(Model):
    """Says what a topic of commands needs. It is no certified safety function."""

    lease_s: Seconds | None = Field(
        None, description="how long a command counts; then the safe message is published. Default: for ever"
    )
    on_expiry: Literal["zero"] | dict[str, Any] = Field(
        "zero", description='the safe message: "zero", or its fields; those left out are zero'
    )
    max: dict[str, CommandMax] = Field(
        default_factory=dict, description='the largest magnitude of fields, by path: {"linear.x": 0.5}'
    )
    lifespan_s: Seconds | None = Field(
        None, description="older commands are refused, counted from the first gateway; default: no limit"
    )
    drivers: Literal["any", "first", "newest"] = Field(
        "any", description="who may drive: any, the first until its lease is over, or the newest (it takes over)"
    )


class BridgedName(Model):
    """A name to bridge, with the options that all operations share."""

    name: Name = Field(description="the name on the local graph; relative to local_namespace")
    type: str = Field(description="its type: pkg/msg/Name, pkg/Name or pkg.msg.Name")
    remote_name: Name | None = Field(None, description="the name on the remote side, where it differs")
    compression: Encoding = Field(
        "auto",
        validation_alias=AliasChoices("compression", "encoding"),
        description="how messages travel; auto takes the fastest that the other side understands",
    )
    israw: IsRaw = Field(False, description='true is another way to say "compression": "cbor-raw"')
    priority: Priority = Field(4, description="lanes: 0 (command) is sent first, 4 is the default, 7 (bulk) last")

    active: Switch = Field(True, description="false: parsed and checked, but paused")
    audit: bool = Field(
        False, description="true writes down every message, call or goal in the audit log: when, from where, its hash"
    )

    author: Metadatum = Field(None, description=METADATUM)
    maintainer: Metadatum = Field(None, description="likewise")
    description: Metadatum = Field(None, description="likewise")
    unique: Metadatum = Field(None, description="likewise: tells deployments of one name apart")
    node: Metadatum = Field(None, description="likewise: the name of the node that has it")

    def delivery(self) -> Delivery:
        """Return how the far side should treat this route."""
        given = ((key, getattr(self, key)) for key in METADATA)
        return Delivery(
            encoding="cbor-raw" if self.israw else self.compression,
            priority=self.priority,
            metadata=tuple((key, text) for key, text in given if text is not None),
        )


class ExpectedTraffic(Model):
    """Says what to expect of a topic, for predictions; nothing that runs depends on it."""

    bytes: float = Field(gt=0, allow_inf_nan=False, description="mean size of a message")
    hz: Seconds = Field(description="messages per second of each publisher")
    publishers: int = Field(1, ge=1, le=10_000, description="how many publish it on the side that it comes from")
    readers: int = Field(1, ge=1, le=10_000, description="how many read it on the other side")
    ratio: float | None = Field(
        None, gt=0, allow_inf_nan=False, description="bytes of a message over those that travel; default: 1"
    )


class TopicItem(BridgedName):
    """A topic to ``publish`` or to ``subscribe``."""

    type: TopicTypeName = Field(
        validation_alias=AliasChoices("type", "messageType"),
        description="its type: pkg/msg/Name, pkg/Name or pkg.msg.Name",
    )
    rate_hz: Seconds | None = Field(None, description="at most this many messages per second; default: no limit")
    lifespan_s: Seconds | None = Field(None, description="older messages (seconds) are not sent; default: no limit")
    weight: float = Field(
        1.0, ge=0.1, le=100, description="share of the link in bytes, beside other topics of the same priority"
    )
    depth: int | None = Field(None, ge=1, description="how many messages may wait; default: as the publisher's QoS")
    store: bool = Field(
        False, description="true keeps the last message: late joiners get it, and it can be read from the store"
    )
    qos: Profile = Field(None, description="QoS on the local graph; default: the publishers' own is adopted")
    safety: CommandSafety | None = Field(
        None,
        description="of a topic of commands that is subscribed: lease, limits, lifespan, drivers; see gateway.safety",
    )
    frame_prefix: FramePrefix = Field(
        "", description='put before the coordinate frames in the messages that cross, such as "robot1/"'
    )
    frame_prefix_removed: FramePrefix = Field(
        "", description="taken away from the coordinate frames in the messages that cross, where they have it"
    )
    frames_kept: Many[str] = Field(("map", "earth"), description="frames that all share, and that stay as they are")
    expected: ExpectedTraffic | None = Field(
        None, description="what to expect of it, for ropeway predict and for a warning where it does not fit the link"
    )

    def delivery(self) -> Delivery:
        """Return how the far side should treat this route."""
        return replace(
            super().delivery(),
            rate_hz=self.rate_hz,
            lifespan_s=self.lifespan_s,
            depth=self.depth,
            weight=self.weight,
        )

    def frames(self) -> FrameNames | None:
        """Return how coordinate frames are called on the other side, ``None`` where they have the same names."""
        if not (self.frame_prefix or self.frame_prefix_removed):
            return None
        return FrameNames(self.frame_prefix, self.frame_prefix_removed, self.frames_kept)


class RenamedTopicItem(TopicItem):
    """A topic to ``trans-publish``: published remotely under another name."""

    remote_name: Name = Field(description="the name on the remote side")


class ServiceItem(BridgedName):
    """A service to expose or to reserve."""

    timeout_s: Seconds | None = Field(None, description="how long a call may take (seconds); default: 60")

    name: Name = Field(
        validation_alias=AliasChoices("name", "service"),
        description="the name on the local graph; relative to local_namespace",
    )
    type: Annotated[str, _type_of("service")] = Field(
        validation_alias=AliasChoices("type", "serviceType"),
        description="its type: pkg/srv/Name, pkg/Name or pkg.srv.Name",
    )


class ActionItem(BridgedName):
    """An action to expose or to reserve."""

    timeout_s: Seconds | None = Field(
        None, description="a goal that takes longer (seconds) is cancelled and aborted; default: no limit"
    )

    name: Name = Field(
        validation_alias=AliasChoices("name", "action"),
        description="the name on the local graph; relative to local_namespace",
    )
    type: Annotated[str, _type_of("action")] = Field(
        validation_alias=AliasChoices("type", "actionType"),
        description="its type: pkg/action/Name, pkg/Name or pkg.action.Name",
    )
