"""IoRT nodes of a gateway: their listeners, and the bridges between their topics and the local graph."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any, Final

from ropeway.bridge.options import BridgeOptions
from ropeway.bridge.topic import TopicBridge
from ropeway.errors import TypesError
from ropeway.fault_log import FaultLog
from ropeway.graph.base import Graph, GraphEvent
from ropeway.networks.iort.graph import IortGraph
from ropeway.networks.iort.links import LocalLink
from ropeway.networks.iort.maps import Maps, TopicMap
from ropeway.networks.iort.server import IortServer
from ropeway.networks.iort.space import Space
from ropeway.qos import LATCHED
from ropeway.tasks import Supervised, describe
from ropeway.types.forms import default_form

if TYPE_CHECKING:
    import ssl
    from collections.abc import AsyncIterator, Iterator

    from ropeway.gateway.config.iort_model import IortConfig
    from ropeway.listener.entrance import Entrance
    from ropeway.store import Entry, Store
    from ropeway.types import TypeRegistry

__all__ = ["Nodes"]

log = logging.getLogger("ropeway.gateway")

_FOUND_LIMIT: Final = 1000  # bridges that patterns may bring about


class Nodes:
    """Serves nodes over ``store``, and shares with the local graph what the maps name.

    ``into`` and ``out_of`` are two views of it, so that what one robot publishes another one with another map hears.

    A map of one topic is a bridge (or one each way) from the start; a map with patterns makes one for every topic
    that a node publishes or subscribes to.
    """

    def __init__(
        self,
        config: IortConfig,
        store: Store,
        into: Graph,
        out_of: Graph,
        registry: TypeRegistry,
        *,
        entrance: Entrance,
        name: str,
    ) -> None:
        self.space = Space(store)
        self.server = IortServer(
            self.space,
            entrance=entrance,
            max_packet_bytes=config.max_packet_bytes,
            max_clients=config.max_nodes,
            render=self._render,
            kinds=config.kinds,
        )
        self.faults: list[str] = []  # of maps that cannot be used
        self.maps = Maps(self._usable([item.as_map() for item in config.maps], registry))
        self.graph = IortGraph(LocalLink(self.space, name), name="iort", maps=self.maps, registry=registry)
        self.bridges: dict[tuple[str, str], TopicBridge] = {}
        self.unshared = 0  # topics that had no place among the bridges
        self._into, self._out_of = into, out_of
        self._fault_log = FaultLog("nodes")
        self._watch = Supervised(lambda: self._look_out(self.graph.changes()), "topics of nodes")

    async def open(self) -> None:
        """Join the topics that the maps name."""
        await self.graph.open()
        for map in self.maps.maps:
            if not map.is_pattern:
                name = map.ros_name(map.system, map.topic)
                for direction in ("in", "out") if map.direction == "both" else (map.direction,):
                    await self._join(direction, name, map)
        if any(map.is_pattern for map in self.maps.maps):
            self._watch.start()

    async def listen(self, url: str, *, ssl_context: ssl.SSLContext | None) -> None:
        """Listen for nodes. Raises ``ConnectFailed``."""
        await self.server.listen(url, ssl_context=ssl_context)

    async def close(self) -> None:
        """Take everything down."""
        await self._watch.close()
        for bridge in self.bridges.values():
            await bridge.close()
        await self.server.close()
        await self.graph.close()
        self.space.close()

    def status(self) -> dict[str, Any]:
        """Return the state as JSON."""
        return {
            **self.server.status(),
            "values": self.space.published,
            "unshared": self.unshared,
            "faults": self.faults,
            "drops": {f"{topic}: {why.value}": n for (topic, why), n in self.graph.drops.items() if n},
            "bridges": [
                {
                    "direction": direction,
                    "name": name,
                    "type": bridge.type,
                    "state": bridge.state,
                    "error": bridge.error,
                    "messages": bridge.meter.messages,
                    "rate_hz": round(bridge.meter.rate_hz, 2),
                }
                for (direction, name), bridge in sorted(self.bridges.items())
            ],
        }

    def _usable(self, maps: list[TopicMap], registry: TypeRegistry) -> Iterator[TopicMap]:
        """Return the maps that fit their types; each other one is told and fails alone."""
        for map in maps:
            try:
                map.make_form(registry)
            except TypesError as error:
                text = f"the map of {map.system}/{map.topic} is left out: {error}"
                log.warning("%s", text)
                self.faults.append(text)
            else:
                yield map

    def _render(self, entry: Entry) -> bytes:
        """Return a ROS message as text, by the map of its topic, or as JSON."""
        map = self.maps.of(entry.system, entry.topic)
        registry = self.graph.registry
        fits = map is not None and map.type == entry.type and map.form not in ("codes", "angle")
        form = map.make_form(registry) if fits and map is not None else default_form(entry.type, registry)
        return form.text(entry.data) or b""

    async def _join(self, direction: str, name: str, map: TopicMap) -> None:
        if (direction, name) in self.bridges:
            return
        source, target = (self.graph, self._into) if direction == "in" else (self._out_of, self.graph)
        bridge = self.bridges[direction, name] = TopicBridge(
            source,
            target,
            name,
            name,
            map.type,
            BridgeOptions(qos=LATCHED if map.latched and direction == "in" else None),
        )
        await bridge.start()

    async def _look_out(self, changes: AsyncIterator[GraphEvent]) -> None:
        async for event in changes:
            if not event.discovered or event.kind not in ("publisher", "subscription"):
                continue
            try:
                await self._found(event.name, "in" if event.kind == "publisher" else "out")
            except Exception as error:  # nodes name their topics as they like; one that cannot be shared fails alone
                self.unshared += 1
                self._fault_log.note("topic", event.name, f"it is not shared: {describe(error)}")
                log.debug("%s is not shared", event.name, exc_info=error)

    async def _found(self, name: str, direction: str) -> None:
        for system, topic, map in self.maps.at(name, direction):
            if map is None or not map.is_pattern:
                continue
            if len(self.bridges) >= _FOUND_LIMIT:
                self.unshared += 1
                text = f"it is not shared: {_FOUND_LIMIT} topics of nodes are, and no more"
                self._fault_log.note("topic", f"{system}/{topic}", text)
                continue
            await self._join(direction, name, map)
