"""Several users of one graph: each hears the others and the network, none hears itself.

A graph does not deliver to its own subscriptions what it publishes itself. A gateway, though, has many users of one
graph: the bridges of every remote and the session of every client. Each gets a ``View``. What one view publishes
goes out to the network and, inside the process, to the subscriptions of all other views, with latched messages for
those who come late. That is how two robots that dial in to one gateway hear each other.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import replace

from ropeway.errors import GraphUnavailable
from ropeway.graph.base import (
    NO_HINTS,
    SEQ_NONE,
    Changes,
    Delivery,
    EndpointInfo,
    Graph,
    GraphEvent,
    NodeInfo,
    Publisher,
    Sample,
    SampleCallback,
    Subscription,
    TopicInfo,
    Undelivered,
    new_origin,
    resolve_name,
)
from ropeway.graph.history import History
from ropeway.graph.seen import Seen
from ropeway.graph.standby import Standby
from ropeway.qos import DEFAULT, QoS, common_qos
from ropeway.tasks import end

__all__ = ["Hub", "View"]

log = logging.getLogger("ropeway.graph.hub")


class Hub:
    """Shares one opened graph among views; opening and closing the graph stays with whoever made it.

    ``open`` makes the hub look out for other gateways on the same network (see ``standby``); without it, it does not.
    """

    def __init__(self, graph: Graph, *, gateway_id: str = "") -> None:
        self.graph = graph
        self.gateway_id = gateway_id
        self._lookout: asyncio.Task[None] | None = None
        self.publishers: dict[str, list[ViewPublisher]] = {}
        self.subscriptions: dict[str, list[ViewSubscription]] = {}
        self.views: list[View] = []
        self.duplicates: Counter[str] = Counter()
        self.retired: dict[str, Seen] = {}  # what publishers gave that were transient local and have closed
        self._seen: dict[str, tuple[Seen, Seen]] = {}

    async def open(self) -> None:
        """Look out for other gateways from now on."""
        if self._lookout is None:
            self._lookout = asyncio.create_task(self._look_out(), name=f"look out on {self.graph.name}")

    async def close(self) -> None:
        """Look out no longer."""
        await end(self._lookout)
        self._lookout = None

    async def _look_out(self) -> None:
        async for event in self.graph.changes():
            if event.kind == "publisher":
                for publisher in list(self.publishers.get(event.name, ())):
                    await publisher.standby.look()

    def seen(self, topic: str) -> tuple[Seen, Seen]:
        """What was had of a topic: what the network gave us, and what we gave the network."""
        found = self._seen.get(topic)
        if found is None:
            found = self._seen[topic] = (Seen(), Seen())
        return found

    def forget(self, topic: str) -> None:
        """Nobody here uses the topic any more."""
        if not self.publishers.get(topic) and not self.subscriptions.get(topic):
            self._seen.pop(topic, None)
            self.retired.pop(topic, None)
            self.publishers.pop(topic, None)
            self.subscriptions.pop(topic, None)

    def announce(self, view: View, kind: str, name: str, type: str, discovered: bool) -> None:
        """Tell the other views what one of them created or closed."""
        for other in self.views:
            if other is not view:
                other.own_changes.emit(GraphEvent(discovered, kind, name, type, "", self.graph.name))

    def view(self, user: str, *, echo: bool = False) -> View:
        """A new user of the graph; with ``echo`` it also hears itself, as a rosbridge client expects."""
        view = View(self, user, echo=echo)
        self.views.append(view)
        return view


class ViewPublisher:
    """A topic published through a view."""

    def __init__(self, view: View, inner: Publisher) -> None:
        self.topic, self.type, self.qos = inner.topic, inner.type, inner.qos
        self.view = view
        self._inner = inner
        self._received, self._published = view.hub.seen(self.topic)
        hub = view.hub
        self.standby = Standby(hub.graph, hub.gateway_id, self.topic, self.type, self._received, self._published)
        self._gid = new_origin()
        self._seq = 0
        self._history = History(self.qos)
        self.given = Seen() if self.qos.transient_local else None
        self._readers: list[ViewSubscription] = []
        self._demand: list[Callable[[int], None]] = []
        self._closed = False
        inner_demand = getattr(inner, "on_demand", None)
        if inner_demand is not None:
            inner.on_demand(lambda _: self._tell())

    def publish(self, sample: Sample) -> None:
        """Send to the network and to the other views."""
        if sample.seq == SEQ_NONE:
            self._seq = max(time.time_ns(), self._seq + 1)
            stamp_ns = sample.stamp_ns or self._seq
            sample = Sample(sample.payload, self.type, stamp_ns, self._gid, self._seq, sent_ns=sample.sent_ns)
        if (self._published.has(sample) or self._received.has(sample)) and not self._takes_over(sample):
            self.view.hub.duplicates[self.topic] += 1
            return
        self._published.add(sample)
        if self.given is not None:
            self.given.add(sample)
        if self._closed:
            return
        if sample.relayed and self.standby.listens:  # in a ring it may be from here, and we hear it in a moment
            self.standby.hold(sample, self._give)
        elif self.standby.defers:
            self.standby.hold(sample, self._inner.publish)
            self._share(sample)
        else:
            self._give(sample)

    def _give(self, sample: Sample) -> None:
        self._inner.publish(sample)
        self._share(sample)

    def _share(self, sample: Sample) -> None:
        """Let our own readers have it, also those to come."""
        if self.qos.transient_local:
            self._history.add(sample)
        for reader in self._readers:
            reader.deliver([sample])

    def _takes_over(self, sample: Sample) -> bool:
        """True for a latched message of a publisher that this one follows: it gives it once more to late joiners."""
        if self.given is None or self.given.has(sample):
            return False
        hub = self.view.hub
        before = hub.retired.get(self.topic)
        if before is not None and before.has(sample):
            return True
        others = (p for p in hub.publishers.get(self.topic, ()) if p.view is self.view)
        return any(other.given is not None and other.given.has(sample) for other in others)

    @property
    def subscribers(self) -> int | None:
        """Readers on the network and in other views."""
        network = self._inner.subscribers
        if network is None:
            return None if not self._readers else len(self._readers)
        return network + len(self._readers)

    def on_demand(self, callback: Callable[[int], None]) -> None:
        """Call with the number of readers, now and at each change."""
        self._demand.append(callback)
        count = self.subscribers
        if count is not None:
            callback(count)

    def match(self, reader: ViewSubscription) -> None:
        """Join a subscription of another view, or part from it."""
        fits = (
            not self._closed
            and not reader.closed
            and reader.type == self.type
            and (reader.view is not self.view or self.view.echo)
        )
        if fits == (reader in self._readers):
            return
        if fits:
            self._readers.append(reader)
            if self.qos.transient_local and reader.wants_history:
                reader.deliver(self._history.replay())
        else:
            self._readers.remove(reader)
        self._tell()

    def _tell(self) -> None:
        count = self.subscribers
        if count is not None:
            for callback in self._demand:
                callback(count)

    async def close(self) -> None:
        """Withdraw the topic."""
        if self._closed:
            return
        self._closed = True
        listed = self.view.hub.publishers.get(self.topic, [])
        if self in listed:
            listed.remove(self)
        for reader in list(self._readers):
            self.match(reader)
            reader.readopt()
        self.view.hub.announce(self.view, "publisher", self.topic, self.type, False)
        if self.given is not None:
            self.view.hub.retired.setdefault(self.topic, Seen()).update(self.given)
        self.view.hub.forget(self.topic)
        await self.standby.close()
        await self._inner.close()


class ViewSubscription:
    """A topic read through a view."""

    def __init__(self, view: View, topic: str, type: str, qos: QoS | None, callback: SampleCallback) -> None:
        self.topic, self.type, self.view = topic, type, view
        self._asked = qos
        self._callback = callback
        self._received, self._published = view.hub.seen(topic)
        self._inner: Subscription | None = None
        self._qos = qos or DEFAULT
        self._qos_callbacks: list[Callable[[QoS], None]] = []
        self.closed = False

    @property
    def wants_history(self) -> bool:
        """True where the reader asked for latched messages, or for whatever fits."""
        return self._asked is None or self._asked.transient_local

    @property
    def qos(self) -> QoS:
        """The profile in use."""
        return self._qos

    def on_qos(self, callback: Callable[[QoS], None]) -> None:
        """Call with the profile, now and when the adopted one changes."""
        self._qos_callbacks.append(callback)
        callback(self._qos)

    def attach(self, inner: Subscription) -> None:
        """Follow the subscription on the graph."""
        self._inner = inner
        inner.on_qos(lambda _: self.readopt())

    def readopt(self) -> None:
        """Adopt what the network's and the other views' publishers offer."""
        if self._asked is not None or self._inner is None or self.closed:
            return
        hub = self.view.hub
        offered = [p.qos for p in hub.publishers.get(self.topic, ()) if p.view is not self.view or self.view.echo]
        topic = hub.graph.topics().get(self.topic)
        if topic is None or any(not p.local for p in topic.publishers) or not offered:
            offered.append(self._inner.qos)
        qos = common_qos(offered)
        if qos != self._qos:
            self._qos = qos
            for callback in self._qos_callbacks:
                callback(qos)

    def arrived(self, batch: Sequence[Sample]) -> None:
        """Messages came from the network: they are known from now on, should a link bring them back."""
        fresh: list[Sample] = []
        for sample in batch:
            self._received.add(sample)
            if sample.relayed and self._published.has(sample):
                self.view.hub.duplicates[self.topic] += 1  # another gateway here published what we did
            else:
                fresh.append(sample)
        self.deliver(fresh)

    def deliver(self, batch: Sequence[Sample]) -> None:
        """Hand messages to the callback; a failure is counted and logged."""
        if self.closed or not batch:
            return
        try:
            self._callback(batch)
        except Exception:  # a callback is somebody else's code; the others must not suffer
            self.view.drops[self.topic, Undelivered.CALLBACK] += len(batch)
            log.exception("%s: a callback for %s failed", self.view.name, self.topic)

    async def close(self) -> None:
        """Stop reading."""
        if self.closed:
            return
        self.closed = True
        listed = self.view.hub.subscriptions.get(self.topic, [])
        if self in listed:
            listed.remove(self)
        for publisher in self.view.hub.publishers.get(self.topic, ()):
            publisher.match(self)
        self.view.hub.announce(self.view, "subscription", self.topic, self.type, False)
        self.view.hub.forget(self.topic)
        if self._inner is not None:
            await self._inner.close()


class View:
    """One user's side of a shared graph; it is a ``Graph`` itself. ``close`` takes back what this user created."""

    def __init__(self, hub: Hub, user: str, *, echo: bool) -> None:
        self.hub = hub
        self.user = user
        self.echo = echo
        self.kind = hub.graph.kind
        self.name = hub.graph.name
        self.drops: Counter[tuple[str, Undelivered]] = hub.graph.drops
        self.own_changes = Changes()
        self._closed = False
        self._parts: list[ViewPublisher | ViewSubscription] = []

    async def open(self) -> None:
        """Nothing to do: the graph is open."""

    async def close(self) -> None:
        """Close what was created through this view."""
        self._closed = True
        for part in list(self._parts):
            await part.close()
        self._parts.clear()
        self.own_changes.close()
        if self in self.hub.views:
            self.hub.views.remove(self)

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> ViewPublisher:
        """See ``Graph.create_publisher``."""
        self._check()
        inner = await self.hub.graph.create_publisher(topic, type, qos, delivery=delivery)
        publisher = ViewPublisher(self, inner)
        self._keep(publisher)
        self.hub.publishers.setdefault(publisher.topic, []).append(publisher)
        for reader in list(self.hub.subscriptions.get(publisher.topic, ())):
            publisher.match(reader)
            reader.readopt()
        self.hub.announce(self, "publisher", publisher.topic, type, True)
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
        self._keep(subscription)
        self.hub.subscriptions.setdefault(subscription.topic, []).append(subscription)
        for publisher in list(self.hub.publishers.get(subscription.topic, ())):
            publisher.match(subscription)
        subscription.readopt()
        self.hub.announce(self, "subscription", subscription.topic, type, True)
        return subscription

    def _check(self) -> None:
        if self._closed:
            raise GraphUnavailable(self.name, f"{self.user} has closed its view")

    def _keep(self, part: ViewPublisher | ViewSubscription) -> None:
        self._parts = [p for p in self._parts if not (p.closed if isinstance(p, ViewSubscription) else p._closed)]
        self._parts.append(part)

    def topics(self) -> dict[str, TopicInfo]:
        """Everything on the graph; what other views created does not count as local."""
        topics = self.hub.graph.topics()
        mine = {(p.topic, isinstance(p, ViewPublisher)) for p in self._parts}
        out: dict[str, TopicInfo] = {}
        for name, info in topics.items():
            out[name] = replace(
                info,
                publishers=tuple(self._seen(e, (name, True) in mine) for e in info.publishers),
                subscriptions=tuple(self._seen(e, (name, False) in mine) for e in info.subscriptions),
            )
        return out

    def types(self, topic: str) -> tuple[str, ...]:
        """The types that one topic has now."""
        info = self.hub.graph.topics().get(topic)
        return info.types if info is not None else ()

    @staticmethod
    def _seen(endpoint: EndpointInfo, mine: bool) -> EndpointInfo:
        return replace(endpoint, local=mine) if endpoint.local else endpoint

    def nodes(self) -> dict[str, NodeInfo]:
        """Every node on the graph."""
        return self.hub.graph.nodes()

    def changes(self) -> AsyncIterator[GraphEvent]:
        """Events of the network and of the other views."""
        return _merged(self.hub.graph.changes(), self.own_changes.listen())


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
