"""Publishes a topic in the overlay."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Final, Protocol

from ropeway.delivery.outbox import Lost, Queue
from ropeway.graph.base import SEQ_NONE, Delivery, Sample, Undelivered
from ropeway.graph.link_parts import LinkStatistics
from ropeway.graph.parts import PublisherBase
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.copies import Copies
from ropeway.networks.overlay.data_key import data_key
from ropeway.networks.overlay.graph.answers import AnsweringHost, AnswerPublishers
from ropeway.networks.overlay.graph.packing import TopicPacking
from ropeway.networks.overlay.packet_item import RELAYED, PacketItem
from ropeway.networks.overlay.publisher_source import PublisherSource

if TYPE_CHECKING:
    import zenoh

__all__ = ["OverlayPublisher", "OverlaySending"]

_REMEMBERED: Final = 4096


class OverlaySending(Protocol):
    """Sends what publishers have."""

    def put(self, queue: Queue[Sample], sample: Sample) -> None:
        """Let a message wait for its turn."""
        ...

    def aim(self, queue: Queue[Sample], gateways: frozenset[bytes]) -> None:
        """Send a publisher's messages to these gateways."""
        ...

    def slowest(self, queue: Queue[Sample]) -> float | None:
        """Return the pace of the slowest path of a publisher, ``None`` where none acknowledges."""
        ...

    async def flush(self, queue: Queue[Sample]) -> None:
        """Wait until a publisher has nothing waiting, for a little while."""
        ...


class OverlayPublisherHost(AnsweringHost, Protocol):
    """The services of a graph for its publishers."""

    @property
    def sender(self) -> OverlaySending:
        """The sender of all publishers."""
        ...

    def remove_publisher(self, publisher: OverlayPublisher) -> None:
        """Forget a publisher that was closed."""
        ...


class OverlayPublisher(PublisherBase[OverlayPublisherHost]):
    """Publishes to every reader that has its key, or to those of one gateway, the target in its advertisement.

    What waits for a congested path gives way to what is fresher.
    """

    def __init__(self, graph: OverlayPublisherHost, advert: Advertisement, delivery: Delivery) -> None:
        assert advert.qos is not None
        super().__init__(graph, advert.name, advert.type, advert.qos)
        self.advert, self.delivery = advert, delivery
        node, target = graph.node, advert.target
        owner = node.membership.certificate(target) if target else None
        self.key = data_key(advert.global_name, advert.endpoint, target if node.membership.aims(target) else b"")
        self._granted: set[bytes] = set()
        self._readers: dict[bytes, bytes] = {}  # endpoint: gateway
        self._answers = None if advert.target else AnswerPublishers(graph, advert, delivery, self.rematch)
        self._had_readers = False
        self._short: zenoh.KeyExpr | None = None
        qos = advert.qos
        keep_all = qos.history == "keep_all"
        depth: int | None = None if keep_all else max(qos.depth, 1)
        self.source = PublisherSource(
            advert.global_name,
            advert.endpoint,
            advert.name,
            node.identity.sign,
            depth=depth if qos.reliable or qos.transient_local else 0,
            lifespan_s=qos.lifespan_s,
            may=lambda reader: (
                graph.allows("subscribe", advert.name, reader)
                and (not target or (owner is not None and owner.fingerprint == reader.fingerprint))
            ),
            rotate_s=node.rotate_s,
            replay=not target,
            sessions=node.sessions,
        )
        lifespan_ns = None if delivery.lifespan_s is None else int(delivery.lifespan_s * 1e9)
        waiting: int | None = delivery.depth
        if waiting is None and not (keep_all and qos.reliable):
            waiting = max(qos.depth, 1)
        self.queue: Queue[Sample] = Queue(self, priority=delivery.priority, depth=waiting, lifespan_ns=lifespan_ns)
        self.queue.latched = qos.latched
        self.queue.weight = delivery.weight
        about, bypass = advert.global_name + advert.endpoint, graph.node.bypass
        self.copies = Copies(partial(bypass.put, self.queue.priority, about))
        self.packing = TopicPacking(self.type, delivery.encoding, lambda: graph.sender.slowest(self.queue))

    @property
    def lost(self) -> Counter[Lost]:
        """Counts of what was not sent, by reason."""
        return self.queue.lost

    def statistics(self) -> LinkStatistics:
        """See ``LinkedPublisher.statistics``."""
        return LinkStatistics(self.packing.used, {reason.value: n for reason, n in self.lost.items() if n})

    def publish(self, sample: Sample) -> None:
        """Send to the readers; without any it is kept for late ones where the profile says so."""
        if self.closed:
            self._graph.drops[self.topic, Undelivered.CLOSED] += 1
            return
        if sample.seq == SEQ_NONE:
            sample = self._numbered(sample, self.advert.endpoint)
        if self._answers:
            self._answers.publish(sample)
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

    def granted(self, subscriptions: Sequence[bytes]) -> None:
        """Note that these subscriptions have the key now."""
        self._granted.update(subscriptions)
        self.rematch()

    def rematch(self) -> None:
        """Match the publisher with its readers anew."""
        alone: set[bytes] = set()
        if self._answers is not None and not self.closed:
            self._answers.refresh()
            alone.update(self._answers.ready())
        found = {
            advert.endpoint: advert.gateway
            for advert in self._graph.node.rib.by_name(self.advert.global_name, "subscription")
            if self.qos.satisfies(advert.qos) and self.advert.target in (b"", advert.gateway)
        }
        known = self._graph.node.membership.certificate
        self.source.subscribed(
            {(owner.fingerprint, gateway) for gateway in found.values() if (owner := known(gateway)) is not None}
        )
        if len(self._granted) > _REMEMBERED:  # those that were here and may come back
            self._granted &= found.keys()
        readers = {
            endpoint: gateway
            for endpoint, gateway in found.items()
            if endpoint in self._granted and gateway not in alone
        }
        self.set_subscribers(len(readers) + len(alone))
        if readers == self._readers:
            return
        self._readers = readers
        self._had_readers = self._had_readers or bool(readers)
        self._graph.sender.aim(self.queue, frozenset(readers.values()))

    async def close(self) -> None:
        """Withdraw the topic."""
        if self.closed:
            return
        self.closed = True
        if self._answers is not None:
            self._answers.close()
        await self._graph.sender.flush(self.queue)
        self._graph.remove_publisher(self)
        if self._short is not None:
            self._graph.node.fabric.forget(self._short)
