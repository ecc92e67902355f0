"""Shares the topics of one graph between its users: a view's messages reach the network and the other views."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Protocol

from ropeway.graph.base import (
    SEQ_NONE,
    Graph,
    Publisher,
    Sample,
    SampleCallback,
    Subscription,
    look_up,
    new_origin,
)
from ropeway.graph.deduplication import KEPT_SAMPLES, Seen
from ropeway.graph.history import History
from ropeway.graph.host import Host
from ropeway.graph.parts import PublisherBase, SubscriptionBase
from ropeway.hub.redundancy import Standby
from ropeway.qos import QoS

__all__ = ["SharedTopics", "TopicUser", "ViewPublisher", "ViewSubscription"]


class SharedTopics(Protocol):
    """Holds what the users of one graph share of its topics; ``Hub`` is one."""

    graph: Graph
    gateway_id: str
    publishers: dict[str, list[ViewPublisher]]
    subscriptions: dict[str, list[ViewSubscription]]
    duplicates: Counter[str]
    retired: dict[str, Seen]

    def seen(self, topic: str) -> tuple[Seen, Seen]:
        """Return the identifiers of samples that came from the network, and of those that were published to it."""
        ...

    def forget(self, topic: str) -> None:
        """Forget a topic that nobody uses any more."""
        ...


class TopicUser(Host, Protocol):
    """Uses a graph that it shares with others; ``View`` is one."""

    echo: bool
    alone: bool

    @property
    def hub(self) -> SharedTopics:
        """Return what the users share."""
        ...

    def announce(self, kind: str, name: str, type: str, discovered: bool) -> None:
        """Tell the other users what this one created or closed."""
        ...


class ViewPublisher(PublisherBase[TopicUser]):
    """A topic published through a view."""

    def __init__(self, view: TopicUser, inner: Publisher) -> None:
        super().__init__(view, inner.topic, inner.type, inner.qos)
        self.view = view
        self._inner, self._send = inner, inner.publish
        self._latched = inner.qos.transient_local
        self._received, self._published = view.hub.seen(self.topic)
        hub = view.hub
        self.standby = Standby(
            hub.graph, hub.gateway_id, self.topic, self.type, self._received, self._published, alone=view.alone
        )
        self._gid = new_origin()
        self._history = History(self.qos)
        self.given = Seen() if self.qos.transient_local else None
        self._readers: list[ViewSubscription] = []
        inner.on_demand(lambda _: self._tell())

    @property
    def inner(self) -> Publisher:
        """Return the publisher on the graph itself."""
        return self._inner

    def publish(self, sample: Sample) -> None:
        """Send to the network and to the other views."""
        if sample.seq == SEQ_NONE:
            sample = self._numbered(sample, self._gid)
        published, received, seq = self._published, self._received, sample.seq
        if (
            (seq in published or seq in received)
            and (published.has(sample) or received.has(sample))
            and not self._takes_over(sample)
        ):
            self.view.hub.duplicates[self.topic] += 1
            return
        published[seq] = None if sample.relayed else sample.origin
        if len(published) > 2 * KEPT_SAMPLES:
            published.trim()
        if self.given is not None:
            self.given.add(sample)
        if self.closed:
            return
        standby = self.standby
        if sample.relayed and standby.listens:  # in a ring it may be from here, and we hear it in a moment
            standby.hold(sample, self._give)
        elif standby.second and standby.defers:
            standby.hold(sample, self._inner.publish)
            self._share(sample)
        else:
            self._send(sample)
            if self._latched or self._readers:
                self._share(sample)

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
        """Return whether this is a latched message of the publisher that this one replaces, to be kept for late joiners
        again.
        """
        if self.given is None or self.given.has(sample):
            return False
        hub = self.view.hub
        before = hub.retired.get(self.topic)
        if before is not None and before.has(sample):
            return True
        others = (p for p in hub.publishers.get(self.topic, ()) if p.view is self.view)
        return any(other.given is not None and other.given.has(sample) for other in others)

    @property
    def kept_bytes(self) -> int:
        """The size of what is kept for late joiners."""
        return self._history.bytes

    @property
    def subscribers(self) -> int | None:
        """Readers on the network and in other views."""
        network = self._inner.subscribers
        if network is None:
            return None if not self._readers else len(self._readers)
        return network + len(self._readers)

    def match(self, reader: ViewSubscription) -> None:
        """Join a subscription of another view, or part from it."""
        fits = (
            not self.closed
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
        if (count := self.subscribers) is not None:
            self._tell_demand(count)

    async def close(self) -> None:
        """Withdraw the topic."""
        if self.closed:
            return
        self.closed = True
        listed = self.view.hub.publishers.get(self.topic, [])
        if self in listed:
            listed.remove(self)
        for reader in list(self._readers):
            self.match(reader)
            reader.readopt()
        self.view.announce("publisher", self.topic, self.type, False)
        if self.given is not None:
            self.view.hub.retired.setdefault(self.topic, Seen()).take_in(self.given)
        self.view.hub.forget(self.topic)
        await self.standby.close()
        await self._inner.close()


class ViewSubscription(SubscriptionBase[TopicUser]):
    """A topic read through a view."""

    def __init__(self, view: TopicUser, topic: str, type: str, qos: QoS | None, callback: SampleCallback) -> None:
        super().__init__(view, topic, type, qos, callback)
        self.view = view
        self._received, self._published = view.hub.seen(topic)
        self._inner: Subscription | None = None

    @property
    def wants_history(self) -> bool:
        """Whether the reader asked for latched messages, or for whatever fits."""
        return self.asked is None or self.asked.transient_local

    @property
    def inner(self) -> Subscription | None:
        """Return the subscription on the graph itself, once there is one."""
        return self._inner

    def attach(self, inner: Subscription) -> None:
        """Follow the subscription on the graph."""
        self._inner = inner
        inner.on_qos(lambda _: self.readopt())

    def readopt(self) -> None:
        """Adopt what the network's and the other views' publishers offer."""
        if self.asked is not None or self._inner is None or self.closed:
            return
        hub = self.view.hub
        offered = [p.qos for p in hub.publishers.get(self.topic, ()) if p.view is not self.view or self.view.echo]
        topic = look_up(hub.graph, "topic", self.topic)
        if topic is None or any(not p.local for p in topic.publishers) or not offered:
            offered.append(self._inner.qos)
        self.adopt(offered)

    def arrived(self, batch: Sequence[Sample]) -> None:
        """Deliver messages from the network, and remember them, should a link bring them back."""
        received, published = self._received, self._published
        fresh: list[Sample] = []
        for sample in batch:
            received[sample.seq] = None if sample.relayed else sample.origin
            if sample.relayed and published.has(sample):
                self.view.hub.duplicates[self.topic] += 1  # another gateway here published what we did
            else:
                fresh.append(sample)
        if len(received) > 2 * KEPT_SAMPLES:
            received.trim()
        if self.closed or not fresh:
            return
        try:
            self._callback(fresh)
        except Exception:  # as in ``SubscriptionBase``
            self._callback_failed(fresh)

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
        self.view.announce("subscription", self.topic, self.type, False)
        self.view.hub.forget(self.topic)
        if self._inner is not None:
            await self._inner.close()
