"""Automatic mode: topics cross the overlay as the local graph needs them (FogROS2-SGC thesis, 3.6).

A topic with publishers here and no subscriber is offered; one with subscribers here and no publisher is fetched; one
with both, or neither, is left alone. It is decided again whenever the graph changes, and taken back when the reason
goes. Only what a pattern allows and none denies is shared.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Iterable
from fnmatch import fnmatchcase
from typing import Any, Final

from ropeway.bridge.topic import TopicBridge
from ropeway.fault_log import FaultLog
from ropeway.gateway.bridges import RouteHost, bridge_options, make_topic_bridge
from ropeway.gateway.config.check import route_key
from ropeway.gateway.config.config import Route
from ropeway.gateway.config.model import RemoteConfig
from ropeway.graph.base import EndpointInfo, Graph, GraphEvent, TopicInfo, resolve_name
from ropeway.tasks import Supervised, describe, end

__all__ = ["Automatic", "wanted"]

log = logging.getLogger("ropeway.gateway")

_SETTLE_S: Final = 0.2  # nodes come with all their topics at once
_NEVER: Final = ("/rosout", "/parameter_events", "/client_count", "/connected_clients")
"""Topics that every ROS network has of its own; allowed only by their full names."""


def _others(endpoints: Iterable[EndpointInfo]) -> bool:
    """Return whether an endpoint belongs to an ordinary node: gateways only follow what is there and are no reason to
    share.
    """
    return any(not endpoint.local and not endpoint.gateway for endpoint in endpoints)


def wanted(topic: TopicInfo) -> str | None:
    """Return what to do with a topic: ``publish`` it to the overlay, ``subscribe`` to it from there, or nothing."""
    published, read = _others(topic.publishers), _others(topic.subscriptions)
    if published == read:
        return None
    return "publish" if published else "subscribe"


class Automatic:
    """Keeps the right topics bridged between ``local`` and ``remote``."""

    def __init__(
        self, local: Graph, remote: Graph, config: RemoteConfig, path: str, graph: str, host: RouteHost
    ) -> None:
        assert config.automatic is not None
        self._local, self._remote, self._config = local, remote, config
        self._allow, self._deny = config.automatic.allow, config.automatic.deny
        self._path, self._graph, self._host = path, graph, host
        self._bridges: dict[str, tuple[Route, TopicBridge]] = {}
        self._left_out: dict[str, str] = {}
        self._fault_log = FaultLog(path)
        self._changed = asyncio.Event()
        self._tasks = (
            Supervised(lambda: self._listen(local.changes()), f"{path}: changes"),
            Supervised(self._keep_deciding, path),
        )

    def bridges(self) -> list[tuple[Route, TopicBridge]]:
        """Return the routes that are bridged now."""
        return list(self._bridges.values())

    def status(self) -> dict[str, Any]:
        """Return the state as JSON: ``left_out`` are topics that cannot be shared, each with the reason."""
        error = next((task.error for task in self._tasks if task.error), "")
        state = "failed" if error else "running"
        return {"state": state, "error": error, "shared": len(self._bridges), "left_out": dict(self._left_out)}

    def allows(self, name: str) -> bool:
        """Return whether a topic may be shared."""
        if name in _NEVER and name not in self._allow:
            return False
        allowed = any(fnmatchcase(name, pattern) for pattern in self._allow)
        return allowed and not any(fnmatchcase(name, pattern) for pattern in self._deny)

    async def start(self) -> None:
        """Decide now, and at each change."""
        for task in self._tasks:
            task.start()

    async def close(self) -> None:
        """Take everything back."""
        await end(*self._tasks)
        for name in list(self._bridges):
            await self._end(name)

    async def _listen(self, changes: AsyncIterator[GraphEvent]) -> None:
        self._changed.set()  # what came before, or while nobody listened
        async for event in changes:
            if event.kind in ("publisher", "subscription"):
                self._changed.set()

    async def _keep_deciding(self) -> None:
        self._changed.set()
        while True:
            await self._changed.wait()
            await asyncio.sleep(_SETTLE_S)
            self._changed.clear()
            await self._decide()

    async def _decide(self) -> None:
        topics = self._local.topics()
        for name, (route, _) in list(self._bridges.items()):
            topic = topics.get(name)
            if topic is None or topic.type != route.type or wanted(topic) != route.operation:
                log.info("%s: %s is not shared any more", self._path, name)
                await self._end(name)
        for name, topic in topics.items():
            operation = wanted(topic)
            if operation is not None and name not in self._bridges and topic.type and self.allows(name):
                await self._try(name, topic.type, operation)
        for name in self._left_out.keys() - topics.keys():
            del self._left_out[name]

    async def _try(self, name: str, type: str, operation: str) -> None:
        """Share a topic; one that cannot be shared is left out, and none of the others with it."""
        try:
            await self._begin(name, type, operation)
        except Exception as error:  # DDS lets any program name a topic as it likes, and types likewise
            reason = describe(error)
            if self._left_out.get(name) != reason:
                self._fault_log.note("topic", name, f"it is left out: {reason}")
                log.debug("%s: %r is left out", self._path, name, exc_info=error)
            self._left_out[name] = reason
            if name in self._bridges:
                await self._end(name)
        else:
            self._left_out.pop(name, None)

    async def _begin(self, name: str, type: str, operation: str) -> None:
        config = self._config
        remote_name = resolve_name(resolve_name(name)[1:], config.remote_namespace)
        route = Route(
            remote=config,
            operation=operation,
            kind="topic",
            name=name,
            remote_name=remote_name,
            type=type,
            path=self._path,
            key=route_key(operation, config.address, self._graph, name, remote_name, type),
            graph=self._graph,
        )
        bridge = make_topic_bridge(route, self._local, self._remote, bridge_options(route, self._host))
        self._bridges[name] = (route, bridge)
        await bridge.start()
        log.info("%s: %s (%s) is %s", self._path, name, type, "offered" if operation == "publish" else "fetched")

    async def _end(self, name: str) -> None:
        _, bridge = self._bridges.pop(name)
        await bridge.close()
