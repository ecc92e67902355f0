"""The local networks of a gateway, and whose definitions of types they have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema, model_serializer

from ropeway.gateway.config.address import parse_graph
from ropeway.gateway.config.fields import ExistingPath, Many, Model
from ropeway.gateway.config.mqtt_model import MqttTopicItem
from ropeway.gateway.config.suggest import one_of, show
from ropeway.types.distros import ROS2_DISTROS

__all__ = ["Distro", "GraphConfig", "GraphItem"]


def _distro(value: str) -> str:
    if value not in ROS2_DISTROS:
        raise ValueError(one_of(value, ROS2_DISTROS))
    return value


def _written_out(value: object) -> object:
    if isinstance(value, str):
        return {"address": parse_graph(value)}
    if isinstance(value, Mapping | GraphConfig):
        return value
    raise ValueError(f"expected a graph such as dds:0, or an object with its address, got {show(value)}")


Distro = Annotated[str, AfterValidator(_distro), WithJsonSchema({"enum": list(ROS2_DISTROS)})]


class GraphConfig(Model):
    """A local network."""

    address: Annotated[str, AfterValidator(parse_graph)] = Field(description="as gateway.graphs lists them")
    distro: Distro | None = Field(
        None,
        description="dds, zenoh: the distribution of ROS 2 whose layouts of types the network has; default: detected",
    )
    types: Many[ExistingPath] = Field(
        (), description="dds, zenoh: files and directories with definitions that count on this network alone"
    )

    topics: Many[MqttTopicItem] = Field(
        (), description="mqtt: types, forms and names of topics of the broker; the first that matches counts"
    )

    @model_serializer
    def _shortest(self) -> str | Mapping[str, Any]:
        topics = [item.model_dump(exclude_defaults=True) for item in self.topics]
        parts = {"address": self.address, "distro": self.distro, "types": list(self.types), "topics": topics}
        found = {key: part for key, part in parts.items() if part}
        return found if len(found) > 1 else self.address


GraphItem = Annotated[
    GraphConfig,
    BeforeValidator(_written_out),
    WithJsonSchema({"anyOf": [{"type": "string"}, {"$ref": "#/$defs/GraphConfig"}]}),
]
"""A network, of which the address alone may be written."""
