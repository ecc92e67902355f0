"""Shares one graph between several users: each hears the others and the network, none hears itself.

A graph does not deliver its own messages to its own subscriptions. A gateway, though, has many users of one graph: the
bridges of every remote and the session of every client. Each gets a ``View``. A view's messages go out to the network
and, inside the process, to the subscriptions of all other views; late joiners get latched messages. That is how two
robots that dial in to one gateway hear each other.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import AsyncIterator, Iterable
from dataclasses import replace
from typing import TypeVar

from ropeway.delivery.client_delays import ClientDelays
from ropeway.errors import GraphUnavailable
from ropeway.graph.base import (
    NO_HINTS,
    Delivery,
    EndpointInfo,
    Graph,
    GraphEvent,
    NodeInfo,
    SampleCallback,
    TopicInfo,
    resolve_name,
)
from ropeway.graph.calls import ActionHandlers, ActionInfo, ServiceHandler, ServiceInfo
from ropeway.graph.changes import Changes
from ropeway.graph.deduplication import Seen
from ropeway.graph.graph_base import GraphBase
from ropeway.graph.kept import Kept
from ropeway.graph.type_inquiry import learn
from ropeway.hub.actions import ViewActionClient, ViewActionServer
from ropeway.hub.calls import ViewClient, ViewService
from ropeway.hub.gated import Gate, GatedPublisher
from ropeway.hub.shared_calls import HubCalls
from ropeway.hub.topics import ViewPublisher, ViewSubscription
from ropeway.qos import QoS
from ropeway.tasks import Supervised, end

__all__ = ["Hub", "View"]

log = logging.getLogger("ropeway.hub")


class Hub:
    """Shares one opened graph among views; opening and closing the graph stays with whoever made it.

    ``open`` makes the hub look out for other gateways on the same network (see ``standby``); without it, it does not.
    """

    def __init__(self, graph: Graph, *, gateway_id: str = "") -> None:
        self.graph = graph
        self.gateway_id = gateway_id
        self._lookout: Supervised | None = None
        self.publishers: dict[str, list[ViewPublisher]] = {}
        self.subscriptions: dict[str, list[ViewSubscription]] = {}
        self.views: list[View] = []
        self.gates: dict[str, Gate] = {}
        """Gates by topic: messages pass them before they are published."""
        self.duplicates: Counter[str] = Counter()
        self.client_delays = ClientDelays()
        self.retired: dict[str, Seen] = {}  # what publishers gave that were transient local and have closed
        self._seen: dict[str, tuple[Seen, Seen]] = {}
        self.calls = HubCalls(graph, gateway_id)
        self.advisers: dict[Graph, None] = {}  # other graphs that may know the types of what is bridged here

    async def open(self) -> None:
        """Watch for other gateways from now on."""
        if self._lookout is None:
            graph = self.graph
            self._lookout = Supervised(lambda: self._look_out(graph.changes()), f"look out on {graph.name}").start()

    async def close(self) -> None:
        """Stop watching for other gateways."""
        await end(self._lookout)
        self._lookout = None
        await self.calls.close()

    async def _look_out(self, changes: AsyncIterator[GraphEvent]) -> None:
        async for event in changes:
            try:
                await self._look_at(event.kind, event.name)
            except Exception:  # of one name: the others are looked at all the same
                log.exception("%s: cannot tell who else has the %s %s", self.graph.name, event.kind, event.name)

    async def _look_at(self, kind: str, name: str) -> None:
        if kind == "publisher":
            for publisher in list(self.publishers.get(name, ())):
                await publisher.standby.look()
        elif kind == "service":
            await self.calls.services.settle(name)
        elif kind == "action":
            await self.calls.actions.settle(name)

    def seen(self, topic: str) -> tuple[Seen, Seen]:
        """Return the identifiers of a topic's samples received from the network, and of those published to it."""
        found = self._seen.get(topic)
        if found is None:
            found = self._seen[topic] = (Seen(), Seen())
        return found

    def forget(self, topic: str) -> None:
        """Drop the state of a topic that no view uses any more."""
        if not self.publishers.get(topic) and not self.subscriptions.get(topic):
            self._seen.pop(topic, None)
            self.retired.pop(topic, None)
            self.publishers.pop(topic, None)
            self.subscriptions.pop(topic, None)

    def types_of(self, kind: str, name: str) -> tuple[str, ...]:
        """Return the types that a ``topic``, ``service`` or ``action`` has now, at the views and on the graph."""
        found = dict.fromkeys(self.graph.types_of(kind, name))
        if kind == "topic":
            found.update(dict.fromkeys(publisher.type for publisher in self.publishers.get(name, ())))
        else:
            holder = (self.calls.services if kind == "service" else self.calls.actions).holder(name)
            found.update({} if holder is None else {holder.provider.type: None})
        return tuple(found)

    def announce(self, view: View, kind: str, name: str, type: str, discovered: bool) -> None:
        """Tell the other views what one of them created or closed."""
        for other in self.views:
            if other is not view:
                other.own_changes.emit(GraphEvent(discovered, kind, name, type, "", self.graph.name))

    def view(self, user: str, *, echo: bool = False, alone: bool = False) -> View:
        """Return a new user of the graph.

        With ``echo`` it also hears itself, as a rosbridge client expects. With ``alone`` nobody else has what it
        publishes to say, so no other gateway needs to be minded.
        """
        view = View(self, user, echo=echo, alone=alone)
        self.views.append(view)
        return view


class View(GraphBase):
    """The side of one user side of a shared graph; it is a ``Graph`` itself. ``close`` takes back what this user
    created.
    """

    def __init__(self, hub: Hub, user: str, *, echo: bool, alone: bool) -> None:
        super().__init__(hub.graph.name)
        self.hub = hub
        self.user = user
        self.echo, self.alone = echo, alone
        self.kind = hub.graph.kind
        self.drops = hub.graph.drops
        self._closed = False
        self._parts: Kept[_Part] = Kept()

    @property
    def own_changes(self) -> Changes:
        """Return what the other views have created and closed."""
        return self._changes

    async def open(self) -> None:
        """Do nothing: the graph is already open."""

    async def close(self) -> None:
        """Close what was created through this view."""
        self._closed = True
        await self._parts.close()
        self._changes.close()
        if self in self.hub.views:
            self.hub.views.remove(self)

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> ViewPublisher:
        """See ``Graph.create_publisher``."""
        self._check()
        inner = await self.hub.graph.create_publisher(topic, type, qos, delivery=delivery)
        gate = None if self.alone else self.hub.gates.get(inner.topic)
        publisher = ViewPublisher(self, inner) if gate is None else GatedPublisher(self, inner, gate, self.user)
        self._parts.add(publisher)
        self.hub.publishers.setdefault(publisher.topic, []).append(publisher)
        for reader in list(self.hub.subscriptions.get(publisher.topic, ())):
            publisher.match(reader)
            reader.readopt()
        self.announce("publisher", publisher.topic, type, True)
        await publisher.standby.look()
        return publisher

    async def create_subscription(
        self,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> ViewSubscription:
        """See ``Graph.create_subscription``."""
        self._check()
        subscription = ViewSubscription(self, resolve_name(topic), type, qos, callback)
        inner = await self.hub.graph.create_subscription(topic, type, qos, subscription.arrived, delivery=delivery)
        subscription.attach(inner)
        self._parts.add(subscription)
        self.hub.subscriptions.setdefault(subscription.topic, []).append(subscription)
        for publisher in list(self.hub.publishers.get(subscription.topic, ())):
            publisher.match(subscription)
        subscription.readopt()
        self.announce("subscription", subscription.topic, type, True)
        return subscription

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> ViewClient:
        """See ``Graph.create_client``; a view also reaches its own services."""
        self._check()
        client = ViewClient(self.hub.calls, resolve_name(service), type)
        await client.attach(delivery)
        self._parts.add(client)
        return client

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> ViewService:
        """See ``Graph.create_service``. Where another holds the name, it waits for it (``taken_by``)."""
        self._check()
        made = ViewService(self.hub.calls, self.user, resolve_name(service), type, handler, delivery)
        await self.hub.calls.services.add(made.entry)
        self._parts.add(made)
        self.announce("service", made.service, type, True)
        made.on_closed = lambda: self.announce("service", made.service, type, False)
        return made

    async def create_action_client(self, action: str, type: str, *, delivery: Delivery = NO_HINTS) -> ViewActionClient:
        """See ``Graph.create_action_client``; a view also reaches its own actions."""
        self._check()
        client = ViewActionClient(self.hub.calls, resolve_name(action), type)
        await client.attach(delivery)
        self._parts.add(client)
        return client

    async def create_action_server(
        self, action: str, type: str, handlers: ActionHandlers, *, delivery: Delivery = NO_HINTS
    ) -> ViewActionServer:
        """See ``Graph.create_action_server``. Where another holds the name, it waits for it (``taken_by``)."""
        self._check()
        made = ViewActionServer(self.hub.calls, self.user, resolve_name(action), type, handlers, delivery)
        await self.hub.calls.actions.add(made.entry)
        self._parts.add(made)
        self.announce("action", made.action, type, True)
        made.on_closed = lambda: self.announce("action", made.action, type, False)
        return made

    def announce(self, kind: str, name: str, type: str, discovered: bool) -> None:
        """Tell the other views what this one created or closed."""
        self.hub.announce(self, kind, name, type, discovered)

    def _check(self) -> None:
        if self._closed:
            raise GraphUnavailable(self.name, f"{self.user} has closed its view")

    def topics(self) -> dict[str, TopicInfo]:
        """Return the topics of the graph; what other views created does not count as local."""
        mine = {
            (part.topic, isinstance(part, ViewPublisher))
            for part in self._parts
            if isinstance(part, (ViewPublisher, ViewSubscription))
        }
        return {
            name: _as_seen(info, publishes=(name, True) in mine, reads=(name, False) in mine)
            for name, info in self.hub.graph.topics().items()
        }

    def count_publishers(self, topic: str) -> tuple[int, int]:
        """See ``Graph.count_publishers``; what other views created does not count as our own."""
        others, own = self.hub.graph.count_publishers(topic)
        return (others, own) if not own or self._has(self.hub.publishers.get(topic, ())) else (others + own, 0)

    def look_up(self, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None:
        """See ``Graph.look_up``; what other views created does not count as local."""
        info = self.hub.graph.look_up(kind, name)
        if isinstance(info, TopicInfo):
            publishes, reads = self.hub.publishers.get(name, ()), self.hub.subscriptions.get(name, ())
            return _as_seen(info, publishes=self._has(publishes), reads=self._has(reads))
        if isinstance(info, ServiceInfo):
            return _shared(info, self._has(self.hub.calls.services.providers(name)))
        if isinstance(info, ActionInfo):
            return _shared(info, self._has(self.hub.calls.actions.providers(name)))
        return None

    def _has(self, parts: Iterable[_Part]) -> bool:
        """Return whether one of the parts of a name was created through this view."""
        return any(part in self._parts for part in parts)

    async def learn(self, type: str) -> bool:
        """See ``Learning.learn``."""
        return await learn(type, self.hub.graph, *self.hub.advisers)

    def types(self, topic: str) -> tuple[str, ...]:
        """Return the types that one topic has now."""
        return self.hub.graph.types_of("topic", topic)

    def service_types(self, service: str) -> tuple[str, ...]:
        """Return the types that one service has now."""
        return self.hub.graph.types_of("service", service)

    def action_types(self, action: str) -> tuple[str, ...]:
        """Return the types that one action has now."""
        return self.hub.graph.types_of("action", action)

    def services(self) -> dict[str, ServiceInfo]:
        """Return every service on the graph; what other views offer does not count as local."""
        mine = {p.service for p in self._parts if isinstance(p, ViewService)}
        return {name: _shared(info, name in mine) for name, info in self.hub.graph.services().items()}

    def actions(self) -> dict[str, ActionInfo]:
        """Return every action on the graph; what other views offer does not count as local."""
        mine = {p.action for p in self._parts if isinstance(p, ViewActionServer)}
        return {name: _shared(info, name in mine) for name, info in self.hub.graph.actions().items()}

    def nodes(self) -> dict[str, NodeInfo]:
        """Return every node on the graph."""
        return self.hub.graph.nodes()

    def changes(self) -> AsyncIterator[GraphEvent]:
        """Iterate over events of the network and of the other views."""
        return _merged(self.hub.graph.changes(), self.own_changes.listen())


_Part = ViewPublisher | ViewSubscription | ViewClient | ViewService | ViewActionClient | ViewActionServer
_Info = TypeVar("_Info", ServiceInfo, ActionInfo)


def _as_seen(info: TopicInfo, *, publishes: bool, reads: bool) -> TopicInfo:
    """Return a topic as a view sees it that ``publishes`` or ``reads`` it itself, or leaves that to other views."""
    publishers = info.publishers if publishes else _of_others(info.publishers)
    subscriptions = info.subscriptions if reads else _of_others(info.subscriptions)
    if publishers is info.publishers and subscriptions is info.subscriptions:
        return info
    return replace(info, publishers=publishers, subscriptions=subscriptions)


def _of_others(ends: tuple[EndpointInfo, ...]) -> tuple[EndpointInfo, ...]:
    if not any(end.local for end in ends):
        return ends
    return tuple(replace(end, local=False) if end.local else end for end in ends)


def _shared(info: _Info, mine: bool) -> _Info:
    if mine or not any(p.local for p in info.servers):
        return info
    return replace(info, servers=tuple(replace(p, local=False) for p in info.servers))


async def _merged(*sources: AsyncIterator[GraphEvent]) -> AsyncIterator[GraphEvent]:
    waiting = {asyncio.create_task(_next(source)): source for source in sources}
    try:
        while waiting:
            done, _ = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                source = waiting.pop(task)
                event = task.result()
                if event is not None:
                    waiting[asyncio.create_task(_next(source))] = source
                    yield event
    finally:
        await end(*waiting)


async def _next(source: AsyncIterator[GraphEvent]) -> GraphEvent | None:
    return await anext(source, None)
