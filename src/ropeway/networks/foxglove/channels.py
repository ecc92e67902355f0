"""Knows what there is to see on a graph: its topics as channels and its services, each with an id and a schema.

All viewers share one table. It is kept up to date while somebody is connected, and asks nodes for the definitions of
types that are not known.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import orjson

from ropeway.errors import TypesError
from ropeway.tasks import Chores, Supervised, end
from ropeway.types.definition_texts import Ros1Texts, Texts

if TYPE_CHECKING:
    from ropeway.graph.base import GraphEvent, TopicInfo
    from ropeway.graph.calls import ServiceInfo
    from ropeway.hub.hub import View
    from ropeway.networks.foxglove.settings import FoxgloveSettings
    from ropeway.types import MessageCodec, TypeRegistry
    from ropeway.types.ros1_spelling import Ros1Spelling

__all__ = ["Catalogue", "SchemaWriter", "ServiceChannel", "TopicChannel"]

log = logging.getLogger("ropeway.server")

_GATHER_S: Final = 0.1  # changes come in flocks; viewers are told of all together
_LEARN_AGAIN_S: Final = 10.0  # a node that did not tell a definition may do so later
_LEARNING: Final = 8  # definitions that are asked for at a time


@dataclass(frozen=True, slots=True)
class TopicChannel:
    """A topic with one of its types. ``told`` is what viewers are told of it, as JSON; ``lacks`` the definition."""

    id: int
    topic: str
    type: str
    told: bytes
    lacks: bool


@dataclass(frozen=True, slots=True)
class ServiceChannel:
    """A service with its first type; the rest as of ``TopicChannel``."""

    id: int
    service: str
    type: str
    told: bytes
    lacks: bool


class SchemaWriter:
    """Writes types, names and messages as viewers of one graph read them: as ROS 1 has them on a ROS 1 graph."""

    def __init__(self, registry: TypeRegistry, ros1: Ros1Spelling | None) -> None:
        self.registry, self._ros1 = registry, ros1
        self._texts = Texts(registry) if ros1 is None else Ros1Texts(ros1)
        self.encoding = "cdr" if ros1 is None else "ros1"
        """The encoding of messages."""
        self.schema_encoding = "ros2msg" if ros1 is None else "ros1msg"

    def name(self, type: str) -> str:
        """Return the name of a type."""
        return type if self._ros1 is None else self._ros1.name(type)

    def schema(self, type: str) -> str | None:
        """Return the definition of a type with all that it contains, ``None`` where it is not known."""
        return self._texts.find(type)

    def codec(self, type: str) -> MessageCodec:
        """Return the codec of a type whose raw bytes and JSON are those that viewers read. Raises ``TypesError``."""
        return self.registry.codec(type) if self._ros1 is None else self._ros1.codec(type)


class Catalogue:
    """The channels and services of a graph as ``view`` sees it, but for hidden ones.

    ``changed`` is called, on the event loop, when it may have others than before, or others use them.
    """

    def __init__(
        self, view: View, writer: SchemaWriter, settings: FoxgloveSettings, changed: Callable[[], None]
    ) -> None:
        self.channels: dict[int, TopicChannel] = {}
        self.services: dict[int, ServiceChannel] = {}
        self._view, self._writer, self._settings, self._changed = view, writer, settings, changed
        self._topics: dict[tuple[str, str], TopicChannel] = {}
        self._calls: dict[tuple[str, str], ServiceChannel] = {}
        self._ids = itertools.count(1)
        self._watch: Supervised | None = None
        self._learning = Chores()
        self._asked: dict[str, float] = {}  # types that are not known, and when a node was asked

    def start(self) -> None:
        """Keep the table up to date from now on."""
        if self._watch is None:
            view = self._view
            self._watch = Supervised(lambda: self._run(view.changes()), "channels of viewers").start()
            self.update()

    async def stop(self) -> None:
        """Keep the table as it is until ``start``."""
        watch, self._watch = self._watch, None
        await end(watch)
        await self._learning.close()

    async def _run(self, changes: AsyncIterator[GraphEvent]) -> None:
        self.look()
        async for _ in changes:
            await asyncio.sleep(_GATHER_S)
            self.update()
            self._changed()  # also where the table is as before: viewers may watch who uses what

    def look(self) -> None:
        """Bring the table up to date, and tell if that changed it."""
        if self.update():
            self._changed()

    def look_for_types(self) -> None:
        """Look again if definitions are lacking: they may have been told meanwhile."""
        if any(entry.lacks for table in (self.channels, self.services) for entry in table.values()):
            self.look()

    def update(self) -> bool:
        """Bring the table up to date; return whether that changed it."""
        topics = [
            (name, type)
            for name, info in self._view.hub.graph.topics().items()
            if _is_used(info) and self._settings.shows_topic(name)
            for type in info.types
        ]
        services = [
            (name, info.type)
            for name, info in self._view.hub.graph.services().items()
            if _is_served(info) and self._settings.shows_service(name)
        ]
        channels = self._renewed(topics, self._topics, self._channel)
        calls = self._renewed(services, self._calls, self._service)
        if channels == self._topics and calls == self._calls:
            return False
        self._topics, self._calls = channels, calls
        self.channels = {channel.id: channel for channel in channels.values()}
        self.services = {service.id: service for service in calls.values()}
        return True

    def _renewed(
        self, found: list[tuple[str, str]], before: dict[tuple[str, str], Any], make: Callable[[str, str], Any]
    ) -> dict[tuple[str, str], Any]:
        """Return the entries of a table; those that stand stay, unless a definition was found that they lacked."""
        out = {}
        for name, type in found:
            entry = before.get((name, type))
            if entry is None or (entry.lacks and self._is_known(type)):
                entry = make(name, type)
            if entry.lacks:
                self._learn(type)
            out[name, type] = entry
        return out

    def _is_known(self, type: str) -> bool:
        first = type + "_Request" if "/srv/" in type else type
        return self._writer.schema(first) is not None

    def _channel(self, topic: str, type: str) -> TopicChannel:
        number, schema = next(self._ids), self._writer.schema(type)
        told = {
            "id": number,
            "topic": topic,
            "encoding": self._writer.encoding,
            "schemaName": self._writer.name(type),
            "schemaEncoding": self._writer.schema_encoding,
            "schema": schema or "",
        }
        return TopicChannel(number, topic, type, orjson.dumps(told), schema is None)

    def _service(self, service: str, type: str) -> ServiceChannel:
        number = next(self._ids)
        told: dict[str, Any] = {"id": number, "name": service, "type": self._writer.name(type)}
        lacks = False
        for part, suffix in (("request", "_Request"), ("response", "_Response")):
            schema = self._writer.schema(type + suffix)
            lacks = lacks or schema is None
            told[f"{part}Schema"] = schema or ""  # as viewers before version 1.2 of the protocol read it
            told[part] = {
                "encoding": self._writer.encoding,
                "schemaName": self._writer.name(type + suffix),
                "schemaEncoding": self._writer.schema_encoding,
                "schema": schema or "",
            }
        return ServiceChannel(number, service, type, orjson.dumps(told), lacks)

    def _learn(self, type: str) -> None:
        """Ask the network for a definition, unless that was done a moment ago."""
        now = time.monotonic()
        if now - self._asked.get(type, float("-inf")) < _LEARN_AGAIN_S or len(self._learning.tasks) >= _LEARNING:
            return
        self._asked = {name: at for name, at in self._asked.items() if now - at < _LEARN_AGAIN_S}
        self._asked[type] = now
        self._learning.start(self._ask(type), f"definition of {type[:100]}")

    async def _ask(self, type: str) -> None:
        try:
            if await self._view.learn(type):
                self.look()
        except TypesError as error:
            log.debug("the definition of %s is not known: %s", type, error)


def _is_used(info: TopicInfo) -> bool:
    """Return whether anybody but our viewers uses a topic, who read only what others have."""
    return bool(info.publishers) or any(not end.local for end in info.subscriptions)


def _is_served(info: ServiceInfo) -> bool:
    return bool(info.servers) and bool(info.types)
