"""Publishes a topic in the overlay."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

from ropeway.delivery.outbox import Lost, Queue
from ropeway.graph.base import SEQ_NONE, Delivery, Sample, Undelivered
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.feed import data_key
from ropeway.networks.overlay.graph.matching import matches
from ropeway.networks.overlay.graph.packing import TopicPacking
from ropeway.networks.overlay.packet_item import RELAYED, PacketItem
from ropeway.networks.overlay.publisher_source import PublisherSource

if TYPE_CHECKING:
    import zenoh

    from ropeway.networks.overlay.graph.graph import OverlayGraph

__all__ = ["OverlayPublisher"]

log = logging.getLogger("ropeway.overlay")

_REMEMBERED: Final = 4096


class OverlayPublisher:
    """Publishes to every reader that has its key; what waits for a congested path gives way to what is fresher."""

    def __init__(self, graph: OverlayGraph, advert: Advertisement, delivery: Delivery) -> None:
        assert advert.qos is not None
        self.topic, self.type, self.qos = advert.name, advert.type, advert.qos
        self.advert, self.delivery = advert, delivery
        self.key = data_key(advert.global_name, advert.endpoint)
        self.closed = False
        self._graph = graph
        self._seq = 0
        self._granted: set[bytes] = set()
        self._readers: dict[bytes, bytes] = {}  # endpoint: gateway
        self._had_readers = False
        self._short: zenoh.KeyExpr | None = None
        self._demand: list[Callable[[int], None]] = []
        qos = advert.qos
        keep_all = qos.history == "keep_all"
        depth: int | None = None if keep_all else max(qos.depth, 1)
        self.source = PublisherSource(
            advert.global_name,
            advert.endpoint,
            advert.name,
            graph.node.identity.sign,
            depth=depth if qos.reliable or qos.transient_local else 0,
            lifespan_s=qos.lifespan_s,
            may=lambda reader: graph.allows("subscribe", advert.name, reader),
            rotate_s=graph.node.rotate_s,
        )
        lifespan_ns = None if delivery.lifespan_s is None else int(delivery.lifespan_s * 1e9)
        waiting: int | None = delivery.depth
        if waiting is None and not (keep_all and qos.reliable):
            waiting = max(qos.depth, 1)
        self.queue: Queue[Sample] = Queue(self, priority=delivery.priority, depth=waiting, lifespan_ns=lifespan_ns)
        self.queue.latched = qos.latched
        self.queue.weight = delivery.weight
        self.packing = TopicPacking(self.type, delivery.encoding, lambda: graph.sender.slowest(self.queue))

    @property
    def lost(self) -> Counter[Lost]:
        """Counts of what was not sent, by reason."""
        return self.queue.lost

    def publish(self, sample: Sample) -> None:
        """Send to the readers; without any it is kept for late ones where the profile says so."""
        if self.closed:
            self._graph.drops[self.topic, Undelivered.CLOSED] += 1
            return
        if sample.seq == SEQ_NONE:
            self._seq = max(time.time_ns(), self._seq + 1)
            stamp_ns = sample.stamp_ns or self._seq
            sample = Sample(sample.payload, self.type, stamp_ns, self.advert.endpoint, self._seq)
        if self._readers:
            self._graph.sender.put(self.queue, sample)
        elif self.qos.transient_local or (self._had_readers and self.qos.reliable):
            self.source.sent(self.add(sample).number)

    def wire_key(self) -> zenoh.KeyExpr:
        """Return the key to put under, in its short form once something is sent."""
        if self._short is None:
            self._short = self._graph.node.fabric.short(self.key)
        return self._short

    def add(self, sample: Sample) -> PacketItem:
        """Number a sample and return it as it goes into a packet."""
        flags = RELAYED if sample.relayed else 0
        return self.source.add(sample.stamp_ns, sample.seq, sample.origin, flags, bytes(sample.payload))

    @property
    def subscribers(self) -> int:
        """The number of others' subscriptions that may read it and have its key."""
        return len(self._readers)

    def on_demand(self, callback: Callable[[int], None]) -> None:
        """Call with the number of subscribers, now and at each change."""
        self._demand.append(callback)
        callback(len(self._readers))

    def granted(self, subscriptions: Sequence[bytes]) -> None:
        """Note that these subscriptions have the key now."""
        self._granted.update(subscriptions)
        self.rematch()

    def rematch(self) -> None:
        """See who reads it."""
        found = {
            advert.endpoint: advert.gateway
            for advert in self._graph.node.rib.by_name(self.advert.global_name, "subscription")
            if matches(self.qos, advert.qos)
        }
        if len(self._granted) > _REMEMBERED:  # those that were here and may come back
            self._granted &= found.keys()
        readers = {endpoint: gateway for endpoint, gateway in found.items() if endpoint in self._granted}
        if readers == self._readers:
            return
        changed = len(readers) != len(self._readers)
        self._readers = readers
        self._had_readers = self._had_readers or bool(readers)
        self._graph.sender.aim(self.queue, frozenset(readers.values()))
        if changed:
            for callback in self._demand:
                self._graph.guard(self.topic, callback, len(readers))

    async def close(self) -> None:
        """Withdraw the topic."""
        if self.closed:
            return
        self.closed = True
        await self._graph.sender.flush(self.queue)
        self._graph.remove_publisher(self)
        if self._short is not None:
            self._graph.node.fabric.forget(self._short)
