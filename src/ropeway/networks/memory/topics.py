"""Topics of the ``memory`` graph: publishers and subscriptions, matched by the rules of ROS 2."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Final, Protocol

from ropeway.graph.base import SEQ_NONE, Sample, SampleCallback, Undelivered, new_origin
from ropeway.graph.history import History
from ropeway.graph.host import Host
from ropeway.graph.parts import PublisherBase, SubscriptionBase
from ropeway.qos import QoS

__all__ = ["MemoryPublisher", "MemorySubscription", "MemoryTopicHost"]

_BACKLOG_LIMIT_BYTES: Final = 256 << 20  # a callback that is this far behind loses the oldest
_REPLAYED_LIMIT: Final = 65_536


class MemoryTopicHost(Host, Protocol):
    """The services of a graph for its topics."""

    node: str
    loop: asyncio.AbstractEventLoop

    def offered(self, topic: str, type: str) -> list[QoS]:
        """Return the profiles of those who publish a topic."""
        ...

    def withdraw(self, part: MemoryPublisher | MemorySubscription) -> None:
        """Forget a part that was closed, and tell the others."""
        ...


class MemoryPublisher(PublisherBase[MemoryTopicHost]):
    """A topic published on a ``MemoryGraph``."""

    def __init__(self, graph: MemoryTopicHost, topic: str, type: str, qos: QoS) -> None:
        super().__init__(graph, topic, type, qos)
        self.graph = graph
        self.gid = new_origin()
        self._history = History(qos)
        self._readers: list[MemorySubscription] = []

    def publish(self, sample: Sample) -> None:
        """Send to every matched subscription."""
        if self.closed:
            self.graph.drops[self.topic, Undelivered.CLOSED] += 1
            return
        if sample.seq == SEQ_NONE:
            sample = self._numbered(sample, self.gid)
        if self.qos.transient_local:
            self._history.add(sample)
        for reader in self._readers:
            reader.put(sample)

    def matches(self, reader: MemorySubscription) -> bool:
        """Return whether a subscription of another participant may read this, by the rules of ROS 2."""
        return (
            reader.topic == self.topic
            and reader.type == self.type
            and reader.graph is not self.graph
            and self.qos.satisfies(reader.qos)
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
        self.set_subscribers(len(self._readers))

    async def close(self) -> None:
        """See ``Publisher.close``."""
        if self.closed:
            return
        self.closed = True
        for reader in list(self._readers):
            self.match(reader)
        self.graph.withdraw(self)


class MemorySubscription(SubscriptionBase[MemoryTopicHost]):
    """A topic read from a ``MemoryGraph``."""

    def __init__(
        self, graph: MemoryTopicHost, topic: str, type: str, qos: QoS | None, callback: SampleCallback
    ) -> None:
        super().__init__(graph, topic, type, qos, callback)
        self.graph = graph
        self.gid = new_origin()
        self._waiting: deque[Sample] = deque()
        self._waiting_bytes = 0
        self._scheduled = False
        self._replayed: set[tuple[bytes, int]] = set()

    def readopt(self) -> None:
        """Follow the publishers' profiles, where the subscription was made to."""
        self.adopt(self.graph.offered(self.topic, self.type))

    def put_once(self, sample: Sample) -> None:
        """Queue a message of a publisher's history, unless this subscription had it already."""
        key = (sample.origin, sample.seq)
        if key not in self._replayed:
            self._replayed.add(key)
            self.put(sample)

    def put(self, sample: Sample) -> None:
        """Queue a message for the callback."""
        if self.qos.transient_local:
            self._replayed.add((sample.origin, sample.seq))
            if len(self._replayed) > _REPLAYED_LIMIT:
                self._replayed.clear()
        self._waiting.append(sample)
        self._waiting_bytes += len(sample.payload)
        while self._waiting_bytes > _BACKLOG_LIMIT_BYTES and len(self._waiting) > 1:
            self._waiting_bytes -= len(self._waiting.popleft().payload)
            self.graph.drops[self.topic, Undelivered.BACKLOG] += 1
        if not self._scheduled:
            self._scheduled = True
            self.graph.loop.call_soon(self._flush)

    def _flush(self) -> None:
        self._scheduled = False
        batch = list(self._waiting)
        self._waiting.clear()
        self._waiting_bytes = 0
        self.deliver(batch)

    async def close(self) -> None:
        """See ``Subscription.close``."""
        if self.closed:
            return
        self.closed = True
        self.graph.withdraw(self)
