"""The topics that requests publish and read: made when they are asked for, and kept for a while after."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncGenerator
from typing import TYPE_CHECKING, Final

from ropeway import aio
from ropeway.errors import InvalidTypeName, TypeConflict
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.limits import REST_IDLE_S, REST_TOPICS
from ropeway.qos import PROFILES, QoS
from ropeway.tasks import Supervised

if TYPE_CHECKING:
    from ropeway.graph.base import Publisher, Subscription
    from ropeway.hub.hub import View
    from ropeway.types import MessageCodec, TypeRegistry

__all__ = ["RestTopics", "TopicUnknown"]

_LOOK_S: Final = 1.0
_PUBLISHED: Final = QoS(durability="transient_local", depth=1, lifespan_s=1.0)
"""As rosbridge publishes for its clients: readers that are matched within a second get the message, too."""


class TopicUnknown(Exception):
    """A topic whose type neither the graph nor the request tells."""


class _Reader:
    """Reads a topic for requests: keeps the last message, and wakes those who follow."""

    def __init__(self) -> None:
        self.subscription: Subscription | None = None
        self.last: Sample | None = None
        self.count = 0
        self.followers = 0
        self.used_s = 0.0
        self.changed = asyncio.Event()

    def arrived(self, batch: list[Sample]) -> None:
        self.last = batch[-1]
        self.count += len(batch)
        changed, self.changed = self.changed, asyncio.Event()
        changed.set()


class RestTopics:
    """Publishes and reads topics of a view. ``unregister_timeout_s``: how long one stays advertised after a request."""

    def __init__(self, view: View, registry: TypeRegistry, *, unregister_timeout_s: float) -> None:
        self._view, self._registry = view, registry
        self._linger_s = unregister_timeout_s
        self._publishers: dict[tuple[str, str], tuple[Publisher, float]] = {}
        self._readers: dict[tuple[str, str], _Reader] = {}
        self._origin = new_origin()
        self._turn = asyncio.Lock()
        self._tidying: Supervised | None = None

    async def type_of(self, name: str, given: str) -> str:
        """Return the type of a topic: as it is there, else as given. Raises ``TopicUnknown`` or ``TypesError``."""
        there = self._view.types(name)
        wanted = self._registry.canonical(given) if given else ""
        if wanted and wanted.split("/")[1] != "msg":
            raise InvalidTypeName(given)
        if there and wanted and wanted not in there:
            raise TypeConflict(name, there[0], wanted)
        type = wanted or (there[0] if there else "")
        if not type:
            raise TopicUnknown
        if not self._registry.has(type):
            await self._view.learn(type)
        return type

    def codec(self, type: str) -> MessageCodec:
        """Return the codec of a type. Raises ``TypesError``."""
        return self._registry.codec(type)

    async def publish(self, name: str, type: str, payload: bytes) -> int | None:
        """Publish a message; return how many read the topic, ``None`` where the network does not tell."""
        async with self._turn:
            self._tidy_later()
            publisher, _ = self._publishers.pop((name, type), (None, 0.0))
            if publisher is None:
                publisher = await self._view.create_publisher(name, type, _PUBLISHED)
            self._publishers[name, type] = publisher, time.monotonic()
            while len(self._publishers) > REST_TOPICS:
                oldest, _ = self._publishers.pop(next(iter(self._publishers)))
                await oldest.close()
            publisher.publish(Sample(payload, type, time.time_ns(), self._origin, SEQ_NONE))
            return publisher.subscribers

    async def last(self, name: str, type: str, timeout_s: float) -> Sample | None:
        """Return the last message of a topic, waiting for the first; ``None`` where none comes in time."""
        reader = await self._reader(name, type)
        if reader.last is None:
            with contextlib.suppress(TimeoutError):
                async with aio.timeout(timeout_s):
                    await reader.changed.wait()
        return reader.last

    async def follow(self, name: str, type: str, idle_s: float) -> AsyncGenerator[tuple[Sample | None, int], None]:
        """Yield messages as they come, with how many were left out: the newest, where the reader is slower.

        ``None`` comes where there was none for ``idle_s``.
        """
        reader = await self._reader(name, type)
        reader.followers += 1
        seen = reader.count - (1 if reader.last is not None else 0)
        try:
            while True:
                if reader.count > seen and reader.last is not None:
                    skipped, seen = reader.count - seen - 1, reader.count
                    yield reader.last, skipped
                    continue
                try:
                    async with aio.timeout(idle_s):
                        await reader.changed.wait()
                except TimeoutError:
                    yield None, 0
        finally:
            reader.followers -= 1
            reader.used_s = time.monotonic()

    async def _reader(self, name: str, type: str) -> _Reader:
        async with self._turn:
            self._tidy_later()
            reader = self._readers.pop((name, type), None)
            if reader is None:
                reader = _Reader()
                reader.subscription = await self._view.create_subscription(
                    name, type, PROFILES["best_available"], lambda batch: reader.arrived(list(batch))
                )
            reader.used_s = time.monotonic()
            self._readers[name, type] = reader
            for key in [key for key, one in self._readers.items() if not one.followers and one is not reader]:
                if len(self._readers) <= REST_TOPICS:
                    break
                await self._end(key)
            return reader

    def _tidy_later(self) -> None:
        if self._tidying is None:
            self._tidying = Supervised(self._tidy, "topics of requests").start()

    async def _tidy(self) -> None:
        """Withdraw what nobody has asked for in a while, for ever."""
        while True:
            await asyncio.sleep(_LOOK_S)
            now = time.monotonic()
            async with self._turn:
                for key, (publisher, used_s) in list(self._publishers.items()):
                    if now - used_s >= self._linger_s:
                        del self._publishers[key]
                        await publisher.close()
                for key, reader in list(self._readers.items()):
                    if not reader.followers and now - reader.used_s >= REST_IDLE_S:
                        await self._end(key)

    async def _end(self, key: tuple[str, str]) -> None:
        reader = self._readers.pop(key)
        if reader.subscription is not None:
            await reader.subscription.close()

    async def close(self) -> None:
        """Withdraw everything."""
        if self._tidying is not None:
            await self._tidying.close()
        for publisher, _ in self._publishers.values():
            await publisher.close()
        for key in list(self._readers):
            await self._end(key)
        self._publishers.clear()
