"""Models the guards of topics on which robots are commanded."""

from __future__ import annotations

from pydantic import Field

from ropeway.gateway.config.route_model import CommandSafety, Name, TopicTypeName

__all__ = ["SafetyItem"]


class SafetyItem(CommandSafety):
    """A topic of the local graph, and what it needs, whoever publishes it through the gateway."""

    topic: Name = Field(description="the topic of the local graph, such as /cmd_vel")
    type: TopicTypeName = Field(description="its type, such as geometry_msgs/msg/Twist")
    graph: str | None = Field(None, description="which of gateway.graphs; default: the first")
