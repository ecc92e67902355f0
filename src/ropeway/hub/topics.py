"""Topics of several users of one graph: what a view publishes reaches the network and the other views."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from ropeway.graph.base import (
    SEQ_NONE,
    Publisher,
    Sample,
    SampleCallback,
    Subscription,
    Undelivered,
    look_up,
    new_origin,
)
from ropeway.graph.deduplication import Seen
from ropeway.graph.history import History
from ropeway.hub.redundancy import Standby
from ropeway.logs import failed
from ropeway.qos import DEFAULT, QoS, common_qos

if TYPE_CHECKING:
    from ropeway.hub.hub import View

__all__ = ["ViewPublisher", "ViewSubscription"]

log = logging.getLogger("ropeway.hub")


class ViewPublisher:
    """A topic published through a view."""

    def __init__(self, view: View, inner: Publisher) -> None:
        self.topic, self.type, self.qos = inner.topic, inner.type, inner.qos
        self.view = view
        self._inner = inner
        self._received, self._published = view.hub.seen(self.topic)
        hub = view.hub
        self.standby = Standby(
            hub.graph, hub.gateway_id, self.topic, self.type, self._received, self._published, alone=view.alone
        )
        self._gid = new_origin()
        self._seq = 0
        self._history = History(self.qos)
        self.given = Seen() if self.qos.transient_local else None
        self._readers: list[ViewSubscription] = []
        self._demand: list[Callable[[int], None]] = []
        self.closed = False
        inner_demand = getattr(inner, "on_demand", None)
        if inner_demand is not None:
            inner.on_demand(lambda _: self._tell())

    @property
    def inner(self) -> Publisher:
        """Return the publisher on the graph itself."""
        return self._inner

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
        if self.closed:
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

    def on_demand(self, callback: Callable[[int], None]) -> None:
        """Call with the number of readers, now and at each change."""
        self._demand.append(callback)
        count = self.subscribers
        if count is not None:
            callback(count)

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
        count = self.subscribers
        if count is not None:
            for callback in self._demand:
                callback(count)

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
        """Whether the reader asked for latched messages, or for whatever fits."""
        return self._asked is None or self._asked.transient_local

    @property
    def qos(self) -> QoS:
        """The profile in use."""
        return self._qos

    def on_qos(self, callback: Callable[[QoS], None]) -> None:
        """Call with the profile, now and when the adopted one changes."""
        self._qos_callbacks.append(callback)
        callback(self._qos)

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
        if self._asked is not None or self._inner is None or self.closed:
            return
        hub = self.view.hub
        offered = [p.qos for p in hub.publishers.get(self.topic, ()) if p.view is not self.view or self.view.echo]
        topic = look_up(hub.graph, "topic", self.topic)
        if topic is None or any(not p.local for p in topic.publishers) or not offered:
            offered.append(self._inner.qos)
        qos = common_qos(offered)
        if qos != self._qos:
            self._qos = qos
            for callback in self._qos_callbacks:
                callback(qos)

    def arrived(self, batch: Sequence[Sample]) -> None:
        """Deliver messages from the network, and remember them, should a link bring them back."""
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
            failed(log, "%s: a callback for %s failed", self.view.name, self.topic)

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
