"""The ``memory`` graph: a network inside one process, for tests, documentation and programs without a middleware.

All ``MemoryGraph`` objects of one name form a network; each is a participant of its own. Rules of matching,
history and adoption are those of ROS 2.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from typing import Final

from ropeway.errors import GraphUnavailable, TypeConflict
from ropeway.graph.action import ComposedActionClient, ComposedActionServer, action_of_service, actions_of
from ropeway.graph.base import (
    NO_HINTS,
    Changes,
    Delivery,
    EndpointInfo,
    GraphEvent,
    NodeInfo,
    SampleCallback,
    TopicInfo,
    Undelivered,
    resolve_name,
)
from ropeway.graph.calls import ActionHandlers, ActionInfo, ProviderInfo, ServiceHandler, ServiceInfo
from ropeway.graph.memory_calls import MemoryClient, MemoryService
from ropeway.graph.memory_topics import MemoryPublisher, MemorySubscription
from ropeway.qos import DEFAULT, QoS
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name

__all__ = ["MemoryGraph", "MemoryPublisher", "MemorySubscription"]

_ACTION_PART: Final = "/_action/"


class _Network:
    """What the participants of one name share."""

    def __init__(self) -> None:
        self.graphs: list[MemoryGraph] = []
        self.publishers: list[MemoryPublisher] = []
        self.subscriptions: list[MemorySubscription] = []
        self.services: list[MemoryService] = []
        self.clients: list[MemoryClient] = []


_networks: dict[str, _Network] = {}


class MemoryGraph:
    """A participant of the in-process network ``network``.

    ``node`` is the node name it shows to others. ``registry`` knows the types of actions; left out, those of ROS 2.
    """

    kind = "memory"

    def __init__(
        self, network: str = "default", *, node: str = "/ropeway", registry: TypeRegistry | None = None
    ) -> None:
        self.name = f"memory:{network}"
        self.node = resolve_name(node)
        self.drops: Counter[tuple[str, Undelivered]] = Counter()
        self._network_name = network
        self._changes = Changes()
        self._open = False
        self._parts: list[MemoryPublisher | MemorySubscription | MemoryService | MemoryClient] = []
        self._actions: list[ComposedActionClient | ComposedActionServer] = []
        self._registry = registry
        self.loop: asyncio.AbstractEventLoop

    @property
    def network(self) -> _Network:
        """What all participants share."""
        return _networks.setdefault(self._network_name, _Network())

    async def open(self) -> None:
        """Join the network."""
        if self._open:
            return
        self.loop = asyncio.get_running_loop()
        self._changes = Changes()
        self._open = True
        self.network.graphs.append(self)

    async def close(self) -> None:
        """Leave the network with everything that was created here."""
        if not self._open:
            return
        for part in [*self._actions, *self._parts]:
            await part.close()
        self._parts.clear()
        self._actions.clear()
        self._open = False
        self.network.graphs.remove(self)
        self._changes.close()
        if not self.network.graphs:
            _networks.pop(self._network_name, None)

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> MemoryPublisher:
        """Publish ``topic``; ``delivery`` has no meaning inside one process."""
        self._check(topic, type)
        publisher = MemoryPublisher(self, resolve_name(topic), type, qos or DEFAULT)
        self._parts.append(publisher)
        self.network.publishers.append(publisher)
        self._rematch(publisher.topic)
        self.announce("publisher", publisher.topic, type, True)
        return publisher

    async def create_subscription(
        self,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> MemorySubscription:
        """Read ``topic``; ``delivery`` has no meaning inside one process."""
        self._check(topic, type)
        subscription = MemorySubscription(self, resolve_name(topic), type, qos, callback)
        self._parts.append(subscription)
        self.network.subscriptions.append(subscription)
        self._rematch(subscription.topic)
        self.announce("subscription", subscription.topic, type, True)
        return subscription

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> MemoryClient:
        """Call ``service`` of another participant; ``delivery`` has no meaning inside one process."""
        self._check(service, type)
        client = MemoryClient(self, resolve_name(service), canonical_name(type, "srv"))
        self._keep(client)
        self.network.clients.append(client)
        return client

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> MemoryService:
        """Serve ``service``; who served the name before goes first. ``delivery`` has no meaning inside one process."""
        self._check(service, type)
        served = MemoryService(self, resolve_name(service), canonical_name(type, "srv"), handler)
        self._keep(served)
        self.network.services.append(served)
        self.announce_service(served, True)
        return served

    async def create_action_client(
        self, action: str, type: str, *, delivery: Delivery = NO_HINTS
    ) -> ComposedActionClient:
        """Use ``action`` of another participant; ``delivery`` has no meaning inside one process."""
        self._check(action, type)
        client = ComposedActionClient(self, action, type, self.registry)
        await client.open()
        self._actions = [*(part for part in self._actions if not part.closed), client]
        return client

    async def create_action_server(
        self, action: str, type: str, handlers: ActionHandlers, *, delivery: Delivery = NO_HINTS
    ) -> ComposedActionServer:
        """Serve ``action``; ``delivery`` has no meaning inside one process."""
        self._check(action, type)
        server = ComposedActionServer(self, action, type, handlers, self.registry)
        await server.open()
        self._actions = [*(part for part in self._actions if not part.closed), server]
        return server

    @property
    def registry(self) -> TypeRegistry:
        """The types that actions are made of."""
        if self._registry is None:
            self._registry = TypeRegistry()
        return self._registry

    def services(self) -> dict[str, ServiceInfo]:
        """Every service of the network, served or called."""
        found: dict[str, tuple[list[MemoryService], list[MemoryClient]]] = {}
        for service in self.network.services:
            found.setdefault(service.service, ([], []))[0].append(service)
        for client in self.network.clients:
            found.setdefault(client.service, ([], []))[1].append(client)
        return {
            name: ServiceInfo(
                name,
                tuple(dict.fromkeys([*(part.type for part in servers), *(part.type for part in clients)])),
                tuple(self._provider(part) for part in servers),
                tuple(self._provider(part) for part in clients),
            )
            for name, (servers, clients) in sorted(found.items())
        }

    def actions(self) -> dict[str, ActionInfo]:
        """Every action of the network, served or used."""
        return actions_of(self.services())

    def topics(self) -> dict[str, TopicInfo]:
        """Every topic of the network; those that actions are made of stand under ``actions``."""
        found: dict[str, tuple[list[EndpointInfo], list[EndpointInfo]]] = {}
        for publisher in self.network.publishers:
            found.setdefault(publisher.topic, ([], []))[0].append(self._endpoint("publisher", publisher))
        for subscription in self.network.subscriptions:
            found.setdefault(subscription.topic, ([], []))[1].append(self._endpoint("subscription", subscription))
        return {
            name: TopicInfo(name, tuple(dict.fromkeys(e.type for e in pubs + subs)), tuple(pubs), tuple(subs))
            for name, (pubs, subs) in sorted(found.items())
            if _ACTION_PART not in name
        }

    def nodes(self) -> dict[str, NodeInfo]:
        """Every participant, as a node."""
        out: dict[str, NodeInfo] = {}
        for graph in self.network.graphs:
            pubs = tuple((p.topic, p.type) for p in self.network.publishers if p.graph is graph)
            subs = tuple((s.topic, s.type) for s in self.network.subscriptions if s.graph is graph)
            served = tuple((s.service, s.type) for s in self.network.services if s.graph is graph)
            called = tuple((c.service, c.type) for c in self.network.clients if c.graph is graph)
            out[graph.node] = NodeInfo(graph.node, pubs, subs, served, called, local=graph is self)
        return out

    def changes(self) -> AsyncIterator[GraphEvent]:
        """Events from now on."""
        return self._changes.listen()

    def announce(self, kind: str, name: str, type: str, discovered: bool) -> None:
        """Tell the other participants of a change here."""
        self._tell(kind, name, type, discovered)
        if not discovered:
            self._rematch(name)
            self._parts = [p for p in self._parts if not p.closed]

    def announce_service(self, service: MemoryService, discovered: bool) -> None:
        """Tell the other participants of a service that came or goes here, and of the action it belongs to."""
        for client in self.network.clients:
            client.look()
        self._tell("service", service.service, service.type, discovered)
        action = action_of_service(service.service, service.type)
        if action is not None:
            self._tell("action", *action, discovered)

    def _tell(self, kind: str, name: str, type: str, discovered: bool) -> None:
        if kind in ("publisher", "subscription") and _ACTION_PART in name:
            return
        for graph in self.network.graphs:
            if graph is not self:
                graph._changes.emit(GraphEvent(discovered, kind, name, type, self.node, graph.name))

    def _keep(self, part: MemoryService | MemoryClient) -> None:
        self._parts = [*(p for p in self._parts if not p.closed), part]

    def _rematch(self, topic: str) -> None:
        network = self.network
        readers = [s for s in network.subscriptions if s.topic == topic]
        for reader in readers:
            reader.readopt()
        for publisher in [p for p in network.publishers if p.topic == topic]:
            for reader in readers:
                publisher.match(reader)

    def _check(self, topic: str, type: str) -> None:
        if not self._open:
            raise GraphUnavailable(self.name, "is not open; call open() first")
        if not type:
            raise TypeConflict(topic, "a type", "none")

    def _provider(self, part: MemoryService | MemoryClient) -> ProviderInfo:
        return ProviderInfo(part.graph.node, local=part.graph is self, gid=part.gid)

    def _endpoint(self, kind: str, part: MemoryPublisher | MemorySubscription) -> EndpointInfo:
        node, local = part.graph.node, part.graph is self
        return EndpointInfo(kind, part.topic, part.type, part.qos, gid=part.gid, node=node, local=local)
