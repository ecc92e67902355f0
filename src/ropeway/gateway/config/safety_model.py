"""Models the guards of topics on which robots are commanded."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from ropeway.gateway.config.fields import Model
from ropeway.gateway.config.route_fields import Name, Seconds, TopicTypeName

__all__ = ["CommandSafety", "SafetyItem"]

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


class SafetyItem(CommandSafety):
    """A topic of the local graph, and what it needs, whoever publishes it through the gateway."""

    topic: Name = Field(description="the topic of the local graph, such as /cmd_vel")
    type: TopicTypeName = Field(description="its type, such as geometry_msgs/msg/Twist")
    graph: str | None = Field(None, description="which of gateway.graphs; default: the first")
