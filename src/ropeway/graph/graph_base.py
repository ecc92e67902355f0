"""Implements what all graphs share; a network adds how it is joined and left, and what its parts are."""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import AsyncIterator, Callable
from typing import Any, TypeVar

from ropeway.errors import GraphUnavailable
from ropeway.graph.actions import ComposedActionClient, ComposedActionServer, actions_of
from ropeway.graph.base import (
    NO_HINTS,
    Delivery,
    Graph,
    GraphEvent,
    TopicInfo,
    Undelivered,
    look_up,
)
from ropeway.graph.calls import ActionHandlers, ActionInfo, ServiceInfo
from ropeway.graph.changes import Changes
from ropeway.graph.kept import Kept
from ropeway.graph.type_inquiry import TypeInquiry
from ropeway.logs import failed
from ropeway.types import TypeRegistry

__all__ = ["ComposingGraph", "GraphBase", "NetworkGraph"]

log = logging.getLogger("ropeway.graph")

T = TypeVar("T")


class GraphBase(Graph):
    """A graph with its counts of drops, its events, and callbacks that cost nobody else anything when they fail."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.drops: Counter[tuple[str, Undelivered]] = Counter()
        self._changes = Changes()

    def guard(self, topic: str, callback: Callable[[T], object], value: T) -> None:
        """See ``Host.guard``."""
        try:
            callback(value)
        except Exception:  # a callback is somebody else's code
            self.drops[topic, Undelivered.CALLBACK] += 1
            failed(log, "%s: a callback for %s failed", self.name, topic)

    def changes(self) -> AsyncIterator[GraphEvent]:
        """See ``Graph.changes``."""
        return self._changes.listen()

    def counts(self) -> tuple[int, int]:
        """See ``Graph.counts``; a network that need not describe everything for it has its own."""
        return len(self.topics()), len(self.nodes())

    def count_publishers(self, topic: str) -> tuple[int, int]:
        """See ``Graph.count_publishers``; a network that need not describe the topic for it has its own."""
        known = look_up(self, "topic", topic)
        if known is None:
            return 0, 0
        own = sum([end.local for end in known.publishers])
        return len(known.publishers) - own, own

    def look_up(self, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None:
        """See ``Graph.look_up``; a network that need not describe all the others for it has its own."""
        if kind == "topic":
            return self.topics().get(name)
        return self.services().get(name) if kind == "service" else self.actions().get(name)

    def types_of(self, kind: str, name: str) -> tuple[str, ...]:
        """See ``Graph.types_of``."""
        known = self.look_up(kind, name)
        return known.types if known is not None else ()


class NetworkGraph(GraphBase):
    """A graph whose network is joined with ``open`` and left with ``close``, in turn.

    A network joins in ``_join`` and leaves in ``_leave``, after all parts that it has added to ``_parts`` have closed.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._is_open = False
        self._turn = asyncio.Lock()
        self._parts: Kept[Any] = Kept()

    async def open(self) -> None:
        """See ``Graph.open``."""
        async with self._turn:
            if not self._is_open:
                self._changes = Changes()
                await self._join()
                self._is_open = True

    async def _join(self) -> None:
        raise NotImplementedError

    async def close(self) -> None:
        """See ``Graph.close``."""
        async with self._turn:
            if not self._is_open:
                return
            await self._close_composed()
            await self._close_parts()
            self._is_open = False
            await self._leave()
            self._changes.close()

    async def _close_composed(self) -> None:
        """Close what is made of other parts, before those."""

    async def _close_parts(self) -> None:
        await self._parts.close()

    async def _leave(self) -> None:
        raise NotImplementedError

    def _check_open(self) -> None:
        if not self._is_open:
            raise GraphUnavailable(self.name, "is not open; call open() first")


class ComposingGraph(NetworkGraph):
    """A graph whose network has topics and services only, and composes actions of them; those close first."""

    def __init__(self, name: str, registry: TypeRegistry | None = None) -> None:
        super().__init__(name)
        self._registry = registry
        self._actions: Kept[ComposedActionClient | ComposedActionServer] = Kept()
        self._inquiry: TypeInquiry | None = None

    async def _close_composed(self) -> None:
        inquiry, self._inquiry = self._inquiry, None
        if inquiry is not None:
            await inquiry.close()
        await self._actions.close()

    def _ask_for_types(self) -> None:
        """Ask the nodes of the network from now on for definitions that are not known here."""
        if self._registry is not None:
            self._inquiry = TypeInquiry(self, self._registry)
            self._inquiry.start()

    async def learn(self, type: str) -> bool:
        """See ``Learning.learn``."""
        return self._inquiry is not None and await self._inquiry.learn(type)

    @property
    def registry(self) -> TypeRegistry:
        """Return the types that actions are made of; unless some were given, those of ROS 2."""
        if self._registry is None:
            self._registry = TypeRegistry()
        return self._registry

    async def create_action_client(
        self, action: str, type: str, *, delivery: Delivery = NO_HINTS
    ) -> ComposedActionClient:
        """See ``Graph.create_action_client``; of ``delivery`` only the metadata counts."""
        self._check_open()
        parts = Delivery(metadata=delivery.metadata)
        return await self._begin(ComposedActionClient(self, action, type, self.registry, delivery=parts))

    async def create_action_server(
        self, action: str, type: str, handlers: ActionHandlers, *, delivery: Delivery = NO_HINTS
    ) -> ComposedActionServer:
        """See ``Graph.create_action_server``; of ``delivery`` only the metadata counts."""
        self._check_open()
        parts = Delivery(metadata=delivery.metadata)
        return await self._begin(ComposedActionServer(self, action, type, handlers, self.registry, delivery=parts))

    async def _begin(self, action: Action) -> Action:
        await action.open()
        self._actions.add(action)
        action.on_closed = lambda: self._actions.discard(action)
        return action

    def actions(self) -> dict[str, ActionInfo]:
        """See ``Graph.actions``."""
        return actions_of(self.services())


Action = TypeVar("Action", ComposedActionClient, ComposedActionServer)
