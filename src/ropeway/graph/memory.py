"""The ``memory`` graph: a network inside one process, for tests, documentation and programs without a middleware.

All ``MemoryGraph`` objects of one name form a network; each is a participant of its own. Rules of matching,
history and adoption are those of ROS 2.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Final

from ropeway.errors import GraphUnavailable, TypeConflict
from ropeway.graph.base import (
    NO_HINTS,
    SEQ_NONE,
    Changes,
    Delivery,
    EndpointInfo,
    GraphEvent,
    NodeInfo,
    Sample,
    SampleCallback,
    TopicInfo,
    Undelivered,
    new_origin,
    resolve_name,
)
from ropeway.graph.history import History
from ropeway.qos import DEFAULT, QoS, common_qos

__all__ = ["MemoryGraph", "MemoryPublisher", "MemorySubscription"]

log = logging.getLogger("ropeway.graph.memory")

_BACKLOG_LIMIT_BYTES: Final = 256 << 20  # a callback that is this far behind loses the oldest


class _Network:
    """What the participants of one name share."""

    def __init__(self) -> None:
        self.graphs: list[MemoryGraph] = []
        self.publishers: list[MemoryPublisher] = []
        self.subscriptions: list[MemorySubscription] = []


_networks: dict[str, _Network] = {}


class MemoryPublisher:
    """A topic published on a ``MemoryGraph``."""

    def __init__(self, graph: MemoryGraph, topic: str, type: str, qos: QoS) -> None:
        self.topic, self.type, self.qos = topic, type, qos
        self.gid = new_origin()
        self._graph = graph
        self._seq = 0
        self._history = History(qos)
        self._readers: list[MemorySubscription] = []
        self._demand: list[Callable[[int], None]] = []
        self.closed = False

    def publish(self, sample: Sample) -> None:
        """Send to every matched subscription."""
        if self.closed:
            self._graph.drops[self.topic, Undelivered.CLOSED] += 1
            return
        if sample.seq == SEQ_NONE:
            self._seq += 1
            sample = Sample(sample.payload, self.type, sample.stamp_ns or time.time_ns(), self.gid, self._seq)
        if self.qos.transient_local:
            self._history.add(sample)
        for reader in self._readers:
            reader.put(sample)

    @property
    def subscribers(self) -> int:
        """How many subscriptions of other participants read it now."""
        return len(self._readers)

    def on_demand(self, callback: Callable[[int], None]) -> None:
        """Call with the number of subscribers, now and at each change."""
        self._demand.append(callback)
        callback(len(self._readers))

    def matches(self, reader: MemorySubscription) -> bool:
        """The matching rules of ROS 2: same topic and type, and the request not stronger than the offer."""
        ask, offer = reader.qos, self.qos
        return (
            reader.topic == self.topic
            and reader.type == self.type
            and reader.graph is not self._graph
            and (offer.reliable or not ask.reliable)
            and (offer.transient_local or not ask.transient_local)
        )

    def match(self, reader: MemorySubscription) -> None:
        """Join a subscription, or part from it where it matches no longer."""
        fits = not self.closed and not reader.closed and self.matches(reader)
        if fits == (reader in self._readers):
            return
        if fits:
            self._readers.append(reader)
            if reader.qos.transient_local:
                for sample in self._history.replay():
                    reader.put_once(sample)
        else:
            self._readers.remove(reader)
        for callback in self._demand:
            callback(len(self._readers))

    async def close(self) -> None:
        """Withdraw the topic."""
        if self.closed:
            return
        self.closed = True
        network = self._graph.network
        network.publishers.remove(self)
        for reader in list(self._readers):
            self.match(reader)
        self._graph.announce("publisher", self.topic, self.type, False)


class MemorySubscription:
    """A topic read from a ``MemoryGraph``."""

    def __init__(self, graph: MemoryGraph, topic: str, type: str, qos: QoS | None, callback: SampleCallback) -> None:
        self.topic, self.type, self.graph = topic, type, graph
        self.gid = new_origin()
        self._adopt = qos is None
        self._qos = qos or DEFAULT
        self._callback = callback
        self._waiting: deque[Sample] = deque()
        self._waiting_bytes = 0
        self._scheduled = False
        self._replayed: set[tuple[bytes, int]] = set()
        self._qos_callbacks: list[Callable[[QoS], None]] = []
        self.closed = False

    @property
    def qos(self) -> QoS:
        """The profile in use."""
        return self._qos

    def on_qos(self, callback: Callable[[QoS], None]) -> None:
        """Call with the profile, now and when the adopted one changes."""
        self._qos_callbacks.append(callback)
        callback(self._qos)

    def readopt(self) -> None:
        """Follow the publishers' profiles, where the subscription was made to."""
        if not self._adopt:
            return
        offered = [p.qos for p in self.graph.network.publishers if p.topic == self.topic and p.type == self.type]
        qos = common_qos(offered, self._qos)
        if qos == self._qos:
            return
        self._qos = qos
        for callback in self._qos_callbacks:
            callback(qos)

    def put_once(self, sample: Sample) -> None:
        """Queue a message of a publisher's history, unless this subscription had it already."""
        key = (sample.origin, sample.seq)
        if key not in self._replayed:
            self._replayed.add(key)
            self.put(sample)

    def put(self, sample: Sample) -> None:
        """Queue a message for the callback."""
        if self._qos.transient_local:
            self._replayed.add((sample.origin, sample.seq))
            if len(self._replayed) > 65536:
                self._replayed.clear()
        self._waiting.append(sample)
        self._waiting_bytes += len(sample.payload)
        while self._waiting_bytes > _BACKLOG_LIMIT_BYTES and len(self._waiting) > 1:
            self._waiting_bytes -= len(self._waiting.popleft().payload)
            self.graph.drops[self.topic, Undelivered.BACKLOG] += 1
        if not self._scheduled:
            self._scheduled = True
            self.graph.loop.call_soon(self._deliver)

    def _deliver(self) -> None:
        self._scheduled = False
        batch: Sequence[Sample] = list(self._waiting)
        self._waiting.clear()
        self._waiting_bytes = 0
        if self.closed or not batch:
            return
        try:
            self._callback(batch)
        except Exception:
            self.graph.drops[self.topic, Undelivered.CALLBACK] += len(batch)
            log.exception("%s: a callback for %s failed", self.graph.name, self.topic)

    async def close(self) -> None:
        """Stop reading."""
        if self.closed:
            return
        self.closed = True
        network = self.graph.network
        network.subscriptions.remove(self)
        for publisher in network.publishers:
            publisher.match(self)
        self.graph.announce("subscription", self.topic, self.type, False)


class MemoryGraph:
    """A participant of the in-process network ``network``.

    ``node`` is the node name it shows to others.
    """

    kind = "memory"

    def __init__(self, network: str = "default", *, node: str = "/ropeway") -> None:
        self.name = f"memory:{network}"
        self.node = resolve_name(node)
        self.drops: Counter[tuple[str, Undelivered]] = Counter()
        self._network_name = network
        self._changes = Changes()
        self._open = False
        self._parts: list[MemoryPublisher | MemorySubscription] = []
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
        for part in list(self._parts):
            await part.close()
        self._parts.clear()
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

    def topics(self) -> dict[str, TopicInfo]:
        """Every topic of the network."""
        found: dict[str, tuple[list[EndpointInfo], list[EndpointInfo]]] = {}
        for publisher in self.network.publishers:
            found.setdefault(publisher.topic, ([], []))[0].append(self._endpoint("publisher", publisher))
        for subscription in self.network.subscriptions:
            found.setdefault(subscription.topic, ([], []))[1].append(self._endpoint("subscription", subscription))
        return {
            name: TopicInfo(name, tuple(dict.fromkeys(e.type for e in pubs + subs)), tuple(pubs), tuple(subs))
            for name, (pubs, subs) in sorted(found.items())
        }

    def nodes(self) -> dict[str, NodeInfo]:
        """Every participant, as a node."""
        out: dict[str, NodeInfo] = {}
        for graph in self.network.graphs:
            pubs = tuple((p.topic, p.type) for p in self.network.publishers if p._graph is graph)
            subs = tuple((s.topic, s.type) for s in self.network.subscriptions if s.graph is graph)
            out[graph.node] = NodeInfo(graph.node, pubs, subs, local=graph is self)
        return out

    def changes(self) -> AsyncIterator[GraphEvent]:
        """Events from now on."""
        return self._changes.listen()

    def announce(self, kind: str, name: str, type: str, discovered: bool) -> None:
        """Tell the other participants of a change here."""
        for graph in self.network.graphs:
            if graph is not self:
                graph._changes.emit(GraphEvent(discovered, kind, name, type, self.node, graph.name))
        if not discovered:
            self._rematch(name)
            self._parts = [p for p in self._parts if not p.closed]

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

    def _endpoint(self, kind: str, part: MemoryPublisher | MemorySubscription) -> EndpointInfo:
        owner = part._graph if isinstance(part, MemoryPublisher) else part.graph
        return EndpointInfo(kind, part.topic, part.type, part.qos, gid=part.gid, node=owner.node, local=owner is self)
