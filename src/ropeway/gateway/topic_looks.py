"""Looks at topics of the local networks, and publishes on them, for people at a dashboard or a command line.

A topic is read while somebody asks for it again and again, and left when nobody has asked for a while. Only the newest
message is held, and it is decoded, in a thread, when it is asked for.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from ropeway.errors import CallFailed, RopewayError
from ropeway.gateway.message_digest import digest
from ropeway.graph.base import SEQ_NONE, Graph, Publisher, Sample, look_up, new_origin
from ropeway.hub.hub import Hub
from ropeway.limits import LOOKED_AT_TOPICS
from ropeway.tasks import Supervised
from ropeway.types import TypeRegistry

__all__ = ["TopicLooks"]

_UNUSED_S: Final = 5.0
_SWEEP_S: Final = 1.0
_RATE_S: Final = 1.0


@dataclass
class _Look:
    """A topic that is read."""

    view: Graph
    type: str
    asked_at_s: float
    count: int = 0
    bytes: int = 0
    sample: Sample | None = None
    rate_hz: float = 0.0
    rate_bps: float = 0.0
    measured: tuple[float, int, int] = (0.0, 0, 0)

    def received(self, batch: Sequence[Sample]) -> None:
        self.count += len(batch)
        self.bytes += sum(len(sample.payload) for sample in batch)
        self.sample = batch[-1]

    def measure(self, now: float) -> None:
        at, count, size = self.measured
        if not at:
            self.measured = (now, self.count, self.bytes)
        elif now - at >= _RATE_S:
            self.rate_hz = (self.count - count) / (now - at)
            self.rate_bps = 8 * (self.bytes - size) / (now - at)
            self.measured = (now, self.count, self.bytes)


@dataclass
class _Drive:
    """A topic that somebody publishes on."""

    view: Graph
    publisher: Publisher
    asked_at_s: float
    origin: bytes = field(default_factory=new_origin)


class TopicLooks:
    """Reads and publishes topics of the graphs of a gateway. ``hubs`` are by the URLs of their graphs."""

    def __init__(
        self, hubs: Mapping[str, Hub], registry: TypeRegistry, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._hubs, self._registry, self._clock = hubs, registry, clock
        self._looks: dict[tuple[str, str], _Look] = {}
        self._drives: dict[tuple[str, str, str], _Drive] = {}
        self._opening = asyncio.Lock()
        self._sweeping: Supervised | None = None

    async def close(self) -> None:
        """Leave all topics."""
        if self._sweeping is not None:
            await self._sweeping.close()
        await self._leave(math.inf)

    def listed(self) -> list[dict[str, Any]]:
        """Return all topics of the graphs as JSON."""
        return [
            {
                "name": topic.name,
                "type": topic.type,
                "graph": url,
                "publishers": sum(not end.local for end in topic.publishers),
                "readers": sum(not end.local for end in topic.subscriptions),
            }
            for url, hub in self._hubs.items()
            for topic in sorted(hub.graph.topics().values(), key=lambda topic: topic.name)
        ]

    async def look(self, topic: str, graph: str = "", *, after: int = 0) -> dict[str, Any]:
        """Return the newest message of a topic as JSON, with its rate; only the rate unless it is one behind ``after``.

        Raises ``RopewayError`` where the topic is not there, or its type not known.
        """
        look = await self._look(topic, graph)
        now = self._clock()
        look.asked_at_s = now
        look.measure(now)
        sample, count = look.sample, look.count
        about = {"name": topic, "type": look.type, "count": count, "rate_hz": round(look.rate_hz, 3)}
        about["bandwidth_bps"] = round(look.rate_bps)
        if sample is None or count <= after:
            return about
        found = await asyncio.to_thread(digest, self._registry, sample)
        return {**about, "bytes": len(sample.payload), "stamp": sample.stamp_ns / 1e9, **found}

    async def publish(self, topic: str, type: str, message: Any, *, driver: str, graph: str = "") -> dict[str, Any]:
        """Publish a message as ``driver``, through the topic's guard where it has one.

        Raises ``RopewayError`` where it does not fit the type.
        """
        payload = self._registry.codec(type).from_json(message)
        drive = await self._drive(topic, type, driver, graph)
        drive.asked_at_s = self._clock()
        drive.publisher.publish(Sample(payload, type, time.time_ns(), drive.origin, SEQ_NONE))
        return {"readers": drive.publisher.subscribers}

    async def _look(self, topic: str, graph: str) -> _Look:
        url = graph or self._graph_of(topic)
        async with self._opening:
            look = self._looks.get((url, topic))
            if look is not None:
                return look
            hub = self._hub(url)
            found = look_up(hub.graph, "topic", topic)
            if found is None or not found.type:
                raise CallFailed(topic, f"nobody publishes it on {url}")
            view = self._view(hub, "look", self._looks)
            look = _Look(view, found.type, self._clock())
            await self._opened(view, view.create_subscription(topic, found.type, None, look.received))
            self._looks[url, topic] = look
            return look

    async def _drive(self, topic: str, type: str, driver: str, graph: str) -> _Drive:
        url = graph or next(iter(self._hubs))
        async with self._opening:
            drive = self._drives.get((url, topic, driver))
            if drive is not None and drive.publisher.type == type:
                return drive
            if drive is not None:
                await drive.view.close()
            view = self._view(self._hub(url), driver, self._drives)
            publisher = await self._opened(view, view.create_publisher(topic, type))
            drive = self._drives[url, topic, driver] = _Drive(view, publisher, self._clock())
            return drive

    def _view(self, hub: Hub, user: str, kept: Mapping[Any, Any]) -> Graph:
        if len(kept) >= LOOKED_AT_TOPICS:
            raise CallFailed("topics", f"{LOOKED_AT_TOPICS} are in use already; leave one, and try again in a moment")
        if self._sweeping is None:
            self._sweeping = Supervised(self._sweep, "looks at topics").start()
        return hub.view(user)

    async def _opened(self, view: Graph, opening: Awaitable[Any]) -> Any:
        try:
            return await opening
        except RopewayError:
            await view.close()
            raise

    def _hub(self, url: str) -> Hub:
        if url not in self._hubs:
            raise CallFailed(url, f"the graphs here are: {', '.join(self._hubs)}")
        return self._hubs[url]

    def _graph_of(self, topic: str) -> str:
        """Return the first graph that has a topic, or else the first."""
        having = (url for url, hub in self._hubs.items() if look_up(hub.graph, "topic", topic) is not None)
        return next(having, next(iter(self._hubs)))

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(_SWEEP_S)
            async with self._opening:
                await self._leave(self._clock() - _UNUSED_S)

    async def _leave(self, before_s: float) -> None:
        """Leave the topics for which nobody has asked since a time."""
        for key, look in list(self._looks.items()):
            if look.asked_at_s < before_s:
                del self._looks[key]
                await look.view.close()
        for place, drive in list(self._drives.items()):
            if drive.asked_at_s < before_s:
                del self._drives[place]
                await drive.view.close()
