"""The ``memory`` graph: a network inside one process, for tests, documentation and programs without a middleware.

All ``MemoryGraph`` objects of one name form a network; each is a participant of its own. Rules of matching,
history and adoption are those of ROS 2.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Final, Generic, TypeVar

from ropeway.errors import TypeConflict
from ropeway.graph.actions import action_of_service, actions_of, service_of_action
from ropeway.graph.base import (
    NO_HINTS,
    Delivery,
    EndpointInfo,
    GraphEvent,
    NodeInfo,
    SampleCallback,
    TopicInfo,
    resolve_name,
)
from ropeway.graph.calls import ActionInfo, ProviderInfo, ServiceHandler, ServiceInfo
from ropeway.graph.graph_base import ComposingGraph
from ropeway.networks.memory.calls import MemoryClient, MemoryService
from ropeway.networks.memory.topics import MemoryPublisher, MemorySubscription
from ropeway.qos import DEFAULT, QoS
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name

__all__ = ["MemoryGraph", "MemoryPublisher", "MemorySubscription"]

_ACTION_PART: Final = "/_action/"


_Part = MemoryPublisher | MemorySubscription | MemoryService | MemoryClient
_P = TypeVar("_P", bound=_Part)


class _Table(Generic[_P]):
    """Holds parts by name; those of one name are in the order of their creation."""

    def __init__(self) -> None:
        self._named: dict[str, dict[_P, None]] = {}

    def add(self, name: str, part: _P) -> None:
        """Add one."""
        self._named.setdefault(name, {})[part] = None

    def remove(self, name: str, part: _P) -> None:
        """Remove one that is there."""
        named = self._named[name]
        del named[part]
        if not named:
            del self._named[name]

    def of(self, name: str) -> list[_P]:
        """Return those of one name."""
        return list(self._named.get(name, ()))

    def names(self) -> list[str]:
        """Return every name that somebody has."""
        return list(self._named)

    def __iter__(self) -> Iterator[_P]:
        return (part for named in self._named.values() for part in named)

    def __len__(self) -> int:
        return sum(map(len, self._named.values()))


class _Network:
    """Holds what the participants of one name share."""

    def __init__(self) -> None:
        self.graphs: list[MemoryGraph] = []
        self.publishers: _Table[MemoryPublisher] = _Table()
        self.subscriptions: _Table[MemorySubscription] = _Table()
        self.services: _Table[MemoryService] = _Table()
        self.clients: _Table[MemoryClient] = _Table()


_networks: dict[str, _Network] = {}


class MemoryGraph(ComposingGraph):
    """A participant of the in-process network ``network``.

    ``node`` is the node name it shows to others. ``registry`` knows the types of actions; left out, those of ROS 2.
    """

    kind = "memory"

    def __init__(
        self, network: str = "default", *, node: str = "/ropeway", registry: TypeRegistry | None = None
    ) -> None:
        super().__init__(f"memory:{network}", registry)
        self.node = resolve_name(node)
        self.loop: asyncio.AbstractEventLoop
        self._network_name = network

    @property
    def network(self) -> _Network:
        """Return what all participants share."""
        network = _networks.get(self._network_name)
        if network is None:
            network = _networks[self._network_name] = _Network()
        return network

    async def _join(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.network.graphs.append(self)

    async def _leave(self) -> None:
        self.network.graphs.remove(self)
        if not self.network.graphs:
            _networks.pop(self._network_name, None)

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> MemoryPublisher:
        """Publish ``topic``; ``delivery`` has no meaning inside one process."""
        self._check(topic, type)
        publisher = MemoryPublisher(self, resolve_name(topic), type, qos or DEFAULT)
        self.network.publishers.add(publisher.topic, publisher)
        self._parts.add(publisher)
        self._rematch(publisher.topic)
        self._tell("publisher", publisher.topic, type, True)
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
        self.network.subscriptions.add(subscription.topic, subscription)
        self._parts.add(subscription)
        self._rematch(subscription.topic)
        self._tell("subscription", subscription.topic, type, True)
        return subscription

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> MemoryClient:
        """Call ``service`` of another participant; ``delivery`` has no meaning inside one process."""
        self._check(service, type)
        client = MemoryClient(self, resolve_name(service), canonical_name(type, "srv"))
        self.network.clients.add(client.service, client)
        self._parts.add(client)
        return client

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> MemoryService:
        """Serve ``service``; who served the name before goes first. ``delivery`` has no meaning inside one process."""
        self._check(service, type)
        served = MemoryService(self, resolve_name(service), canonical_name(type, "srv"), handler)
        self.network.services.add(served.service, served)
        self._parts.add(served)
        self._tell_service(served, True)
        return served

    def services(self) -> dict[str, ServiceInfo]:
        """Return every service of the network, served or called."""
        network = self.network
        return {name: self._service(name) for name in sorted({*network.services.names(), *network.clients.names()})}

    def _service(self, name: str) -> ServiceInfo:
        servers, clients = self.network.services.of(name), self.network.clients.of(name)
        return ServiceInfo(
            name,
            tuple(dict.fromkeys([*(part.type for part in servers), *(part.type for part in clients)])),
            tuple(self._provider(part) for part in servers),
            tuple(self._provider(part) for part in clients),
        )

    def topics(self) -> dict[str, TopicInfo]:
        """Return every topic of the network; those that belong to actions stand under ``actions``."""
        return {name: self._topic(name) for name in sorted(self._topic_names())}

    def _topic_names(self) -> set[str]:
        names = {*self.network.publishers.names(), *self.network.subscriptions.names()}
        return {name for name in names if _ACTION_PART not in name}

    def counts(self) -> tuple[int, int]:
        """See ``Graph.counts``."""
        return len(self._topic_names()), len({graph.node for graph in self.network.graphs})

    def _topic(self, name: str) -> TopicInfo:
        network = self.network
        publishers = tuple(self._endpoint("publisher", part) for part in network.publishers.of(name))
        subscriptions = tuple(self._endpoint("subscription", part) for part in network.subscriptions.of(name))
        types = tuple(dict.fromkeys(endpoint.type for endpoint in publishers + subscriptions))
        return TopicInfo(name, types, publishers, subscriptions)

    def count_publishers(self, topic: str) -> tuple[int, int]:
        """See ``Graph.count_publishers``."""
        if _ACTION_PART in topic:
            return 0, 0
        found = self.network.publishers.of(topic)
        own = sum([part.graph is self for part in found])
        return len(found) - own, own

    def look_up(self, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None:
        """See ``Graph.look_up``."""
        if kind == "topic":
            topic = self._topic(name)
            return topic if topic.types and _ACTION_PART not in name else None
        service = self._service(name if kind == "service" else service_of_action(name))
        if not service.types:
            return None
        return service if kind == "service" else actions_of({service.name: service}).get(name)

    def nodes(self) -> dict[str, NodeInfo]:
        """Return every participant, as a node."""
        out: dict[str, NodeInfo] = {}
        for graph in self.network.graphs:
            pubs = tuple((p.topic, p.type) for p in self.network.publishers if p.graph is graph)
            subs = tuple((s.topic, s.type) for s in self.network.subscriptions if s.graph is graph)
            served = tuple((s.service, s.type) for s in self.network.services if s.graph is graph)
            called = tuple((c.service, c.type) for c in self.network.clients if c.graph is graph)
            out[graph.node] = NodeInfo(graph.node, pubs, subs, served, called, local=graph is self)
        return out

    # ── for the parts ──────────────────────────────────────────────────────────────────────────────────────────

    def offered(self, topic: str, type: str) -> list[QoS]:
        """See ``MemoryTopicHost``."""
        return [publisher.qos for publisher in self.network.publishers.of(topic) if publisher.type == type]

    def provider(self, service: str, type: str) -> MemoryService | None:
        """See ``MemoryCallHost``: it is the one who has served it longest."""
        for served in self.network.services.of(service):
            if served.type == type and served.graph is not self:
                return served
        return None

    def withdraw(self, part: _Part) -> None:
        """See ``MemoryTopicHost`` and ``MemoryCallHost``."""
        network = self.network
        if isinstance(part, MemoryPublisher):
            network.publishers.remove(part.topic, part)
            self._withdrawn("publisher", part)
        elif isinstance(part, MemorySubscription):
            network.subscriptions.remove(part.topic, part)
            for publisher in network.publishers.of(part.topic):
                publisher.match(part)
            self._withdrawn("subscription", part)
        elif isinstance(part, MemoryService):
            network.services.remove(part.service, part)
            self._tell_service(part, False)
        else:
            network.clients.remove(part.service, part)
        self._parts.discard(part)

    def _withdrawn(self, kind: str, part: MemoryPublisher | MemorySubscription) -> None:
        self._tell(kind, part.topic, part.type, False)
        self._rematch(part.topic)

    def _tell_service(self, service: MemoryService, discovered: bool) -> None:
        """Tell the other participants of a service that comes or goes here, and of the action it belongs to."""
        for client in self.network.clients.of(service.service):
            client.changed.notify()
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

    def _rematch(self, topic: str) -> None:
        network = self.network
        readers = network.subscriptions.of(topic)
        for reader in readers:
            reader.readopt()
        for publisher in network.publishers.of(topic):
            for reader in readers:
                publisher.match(reader)

    def _check(self, topic: str, type: str) -> None:
        self._check_open()
        if not type:
            raise TypeConflict(topic, "a type", "none")

    def _provider(self, part: MemoryService | MemoryClient) -> ProviderInfo:
        return ProviderInfo(part.graph.node, local=part.graph is self, gid=part.gid)

    def _endpoint(self, kind: str, part: MemoryPublisher | MemorySubscription) -> EndpointInfo:
        node, local = part.graph.node, part.graph is self
        return EndpointInfo(kind, part.topic, part.type, part.qos, gid=part.gid, node=node, local=local)
