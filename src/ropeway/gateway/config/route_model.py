"""Models of the names that a configuration has cross: topics, services and actions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Final

from pydantic import AliasChoices, Field

from ropeway.gateway.config.expected_model import ExpectedTraffic
from ropeway.gateway.config.fields import Many, Model, Switch
from ropeway.gateway.config.overlay_model import METADATA, METADATUM, Metadatum
from ropeway.gateway.config.route_fields import (
    Encoding,
    FramePrefix,
    IsRaw,
    Name,
    Priority,
    Profile,
    Seconds,
    TopicTypeName,
    type_of,
)
from ropeway.gateway.config.route_options import RouteOptions
from ropeway.gateway.config.safety_model import CommandSafety
from ropeway.graph.base import Delivery
from ropeway.types.frame_names import FrameNames

__all__ = ["OPERATIONS", "ActionItem", "BridgedName", "RenamedTopicItem", "ServiceItem", "TopicItem"]

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

    def options(self) -> RouteOptions:
        """Return how the route treats what crosses it."""
        return RouteOptions(delivery=self.delivery(), audit=self.audit)


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

    def options(self) -> RouteOptions:
        """Return how the route treats what crosses it."""
        return replace(super().options(), qos=self.qos, store=self.store, frames=self.frames())

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
    type: Annotated[str, type_of("service")] = Field(
        validation_alias=AliasChoices("type", "serviceType"),
        description="its type: pkg/srv/Name, pkg/Name or pkg.srv.Name",
    )

    def options(self) -> RouteOptions:
        """Return how the route treats what crosses it."""
        return replace(super().options(), timeout_s=self.timeout_s)


class ActionItem(BridgedName):
    """An action to expose or to reserve."""

    timeout_s: Seconds | None = Field(
        None, description="a goal that takes longer (seconds) is cancelled and aborted; default: no limit"
    )

    name: Name = Field(
        validation_alias=AliasChoices("name", "action"),
        description="the name on the local graph; relative to local_namespace",
    )
    type: Annotated[str, type_of("action")] = Field(
        validation_alias=AliasChoices("type", "actionType"),
        description="its type: pkg/action/Name, pkg/Name or pkg.action.Name",
    )

    def options(self) -> RouteOptions:
        """Return how the route treats what crosses it."""
        return replace(super().options(), timeout_s=self.timeout_s)
