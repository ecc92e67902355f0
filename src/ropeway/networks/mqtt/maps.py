"""Maps topics of a broker to ROS topics: names, types, and the form of their payloads."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from ropeway.errors import InvalidName
from ropeway.networks.mqtt.names import is_pattern, matches, mqtt_topic, ros_name
from ropeway.types import TypeRegistry
from ropeway.types.codec import MessageCodec
from ropeway.types.forms import RAW_TYPES, Form, make_form

__all__ = ["BYTES", "STRING", "MqttMap", "MqttMaps", "form_of"]

STRING: Final = "std_msgs/msg/String"
BYTES: Final = "std_msgs/msg/UInt8MultiArray"


@dataclass(frozen=True)
class MqttMap:
    """Maps a topic of a broker, or all that match a filter, to ROS.

    ``name`` is the ROS name, ``""`` for that of the topic; all topics of a filter with a name are read as one.
    ``direction`` is ``both``, ``in`` (ROS reads) or ``out``. ``latched``: late joiners in ROS get the last value, and
    what ROS publishes is retained.
    """

    topic: str
    type: str = STRING
    form: str = ""
    name: str = ""
    direction: str = "both"
    latched: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_pattern(self) -> bool:
        """Whether it stands for several topics."""
        return is_pattern(self.topic)

    def ros_name(self, topic: str) -> str:
        """Return the ROS name of a topic that it matches. Raises ``InvalidName``."""
        return self.name or ros_name(topic)


class MqttMaps:
    """An ordered list of maps; the first that matches counts."""

    def __init__(self, maps: Iterable[MqttMap] = ()) -> None:
        self.maps = tuple(maps)
        self._named = {map.name: map for map in reversed(self.maps) if map.name}

    def of(self, topic: str) -> MqttMap | None:
        """Return the map of a topic of the broker, ``None`` for an unmapped one."""
        return next((map for map in self.maps if matches(map.topic, topic)), None)

    def name_of(self, topic: str) -> str:
        """Return the ROS name of a topic of the broker. Raises ``InvalidName`` for one that has none."""
        map = self.of(topic)
        return ros_name(topic) if map is None else map.ros_name(topic)

    def at(self, name: str, direction: str) -> tuple[str, MqttMap | None]:
        """Return the topic or filter behind a ROS name, ``in`` or ``out``, and its map.

        Raises ``InvalidName`` where there is none.
        """
        map = self._named.get(name)
        if map is None:
            topic = mqtt_topic(name)
            map = self.of(topic)
            if map is not None and map.name:
                raise InvalidName(name, f"the topic {topic} of the broker has the name {map.name} here")
        else:
            topic = map.topic
        if map is not None and map.direction not in ("both", direction):
            raise InvalidName(name, f"its map has the direction {map.direction}")
        if direction == "out" and is_pattern(topic):
            raise InvalidName(name, f"{topic} stands for several topics, which can be read only")
        return topic, map


def form_of(
    map: MqttMap | None, type: str, registry: TypeRegistry, clock: Callable[[], float] = time.monotonic
) -> tuple[str, Form]:
    """Return the form of a topic and its name: that of its map, or what fits the type. Raises ``TypesError``.

    Without a map a type with a single text, number or truth value is written as that, as devices do it.
    """
    name = map.form if map is not None else ""
    if not name:
        name = "raw" if type in RAW_TYPES else "text" if _is_single(registry.codec(type)) else "json"
    return name, make_form(name, type, registry, map.options if map is not None else {}, clock=clock)


def _is_single(codec: MessageCodec) -> bool:
    return len(codec.fields) == 1 and isinstance(codec.default()[codec.fields[0]], (str, bool, int, float))
