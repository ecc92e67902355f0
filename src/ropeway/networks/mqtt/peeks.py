"""Finds out whether a broker keeps a value of a topic that nobody announces: it is read for a moment.

Only so is a topic known to be latched before somebody reads it, and who bridges it has to know that first.
"""

from __future__ import annotations

import asyncio
from typing import Final

from ropeway.errors import InvalidName
from ropeway.limits import MQTT_PEEKS
from ropeway.networks.mqtt.connection import MqttConnection, Wish
from ropeway.networks.mqtt.maps import MqttMaps
from ropeway.networks.mqtt.reading import MqttFeeds
from ropeway.tasks import Chores

__all__ = ["Peeks"]

_MOMENT_S: Final = 1.0


class Peeks:
    """Looks once at each topic that was asked for, and again after each new connection."""

    def __init__(self, connection: MqttConnection, feeds: MqttFeeds, maps: MqttMaps, chores: Chores) -> None:
        self._connection, self._feeds, self._maps, self._chores = connection, feeds, maps, chores
        self._wanted: dict[str, str] = {}  # by ROS name: the topic or filter

    def want(self, name: str) -> None:
        """Look at a topic, unless that was done on this connection."""
        if name in self._wanted or len(self._wanted) >= MQTT_PEEKS:
            return
        try:
            filter, _ = self._maps.at(name, "in")
        except InvalidName:
            return
        self._wanted[name] = filter
        self._begin(filter)

    def again(self) -> None:
        """Look at all topics again: the connection is new."""
        for filter in self._wanted.values():
            self._begin(filter)

    def _begin(self, filter: str) -> None:
        if self._connection.connected and self._feeds.get(filter) is None:
            self._chores.start(self._look(filter), f"{self._connection.name}: looking at {filter}")

    async def _look(self, filter: str) -> None:
        await self._connection.subscribe(filter, Wish(0, retained=True))
        await asyncio.sleep(_MOMENT_S)
        if self._feeds.get(filter) is None:  # else it is read for good by now
            self._connection.unsubscribe(filter)
