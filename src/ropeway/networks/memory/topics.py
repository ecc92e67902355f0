"""Topics of the ``memory`` graph: publishers and subscriptions, matched by the rules of ROS 2."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

from ropeway.graph.base import SEQ_NONE, Sample, SampleCallback, Undelivered, new_origin
from ropeway.graph.history import History
from ropeway.logs import failed
from ropeway.qos import DEFAULT, QoS, common_qos

if TYPE_CHECKING:
    from ropeway.networks.memory.graph import MemoryGraph

__all__ = ["MemoryPublisher", "MemorySubscription"]

log = logging.getLogger("ropeway.memory")

_BACKLOG_LIMIT_BYTES: Final = 256 << 20  # a callback that is this far behind loses the oldest


class MemoryPublisher:
    """A topic published on a ``MemoryGraph``."""

    def __init__(self, graph: MemoryGraph, topic: str, type: str, qos: QoS) -> None:
        self.topic, self.type, self.qos = topic, type, qos
        self.gid = new_origin()
        self.graph = graph
        self._seq = 0
        self._history = History(qos)
        self._readers: list[MemorySubscription] = []
        self._demand: list[Callable[[int], None]] = []
        self.closed = False

    def publish(self, sample: Sample) -> None:
        """Send to every matched subscription."""
        if self.closed:
            self.graph.drops[self.topic, Undelivered.CLOSED] += 1
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
        """The number of subscriptions of other participants that read it now."""
        return len(self._readers)

    def on_demand(self, callback: Callable[[int], None]) -> None:
        """Call with the number of subscribers, now and at each change."""
        self._demand.append(callback)
        callback(len(self._readers))

    def matches(self, reader: MemorySubscription) -> bool:
        """Apply the matching rules of ROS 2: same topic and type, and the request not stronger than the offer."""
        ask, offer = reader.qos, self.qos
        return (
            reader.topic == self.topic
            and reader.type == self.type
            and reader.graph is not self.graph
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
        network = self.graph.network
        network.publishers.remove(self.topic, self)
        for reader in list(self._readers):
            self.match(reader)
        self.graph.announce("publisher", self.topic, self.type, False)


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
        offered = [p.qos for p in self.graph.network.publishers.of(self.topic) if p.type == self.type]
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
        except Exception:  # a callback is somebody else's code; the others must not suffer
            self.graph.drops[self.topic, Undelivered.CALLBACK] += len(batch)
            failed(log, "%s: a callback for %s failed", self.graph.name, self.topic)

    async def close(self) -> None:
        """Stop reading."""
        if self.closed:
            return
        self.closed = True
        network = self.graph.network
        network.subscriptions.remove(self.topic, self)
        for publisher in network.publishers.of(self.topic):
            publisher.match(self)
        self.graph.announce("subscription", self.topic, self.type, False)
