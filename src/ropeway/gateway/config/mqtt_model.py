"""Models how topics of an MQTT broker map to ROS topics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator, Field, model_validator

from ropeway.gateway.config.iort_model import FormItem
from ropeway.networks.mqtt.names import check_filter, is_pattern

if TYPE_CHECKING:
    from ropeway.networks.mqtt.maps import MqttMap

__all__ = ["MqttTopicItem"]


class MqttTopicItem(FormItem):
    """Maps a topic of a broker, or all that match a filter, to a ROS topic."""

    topic: Annotated[str, AfterValidator(check_filter)] = Field(
        description="the topic at the broker, or a filter such as factory/+/odom"
    )

    @model_validator(mode="after")
    def _one_way(self) -> MqttTopicItem:
        if self.name and is_pattern(self.topic) and self.direction != "in":
            raise ValueError('several topics under one name can be read only; write "direction": "in"')
        return self

    def as_map(self) -> MqttMap:
        """Return the map in the form that the graph uses."""
        from ropeway.networks.mqtt.maps import MqttMap

        name, options = self.name or "", self._options()
        return MqttMap(self.topic, self.type, self.form, name, self.direction, self.latched, options)
