"""Subscribes to a topic in the overlay."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol

from ropeway.graph.base import Sample, SampleCallback, Undelivered
from ropeway.graph.parts import SubscriptionBase
from ropeway.group.stamp import StampReader, stamp_reader
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.feed import Feed
from ropeway.networks.overlay.graph.host import OverlayHost
from ropeway.networks.overlay.packet_item import RELAYED, PacketItem
from ropeway.networks.overlay.publisher_stream import PublisherStream
from ropeway.qos import DEFAULT, QoS
from ropeway.types import TypeRegistry

__all__ = ["OverlaySubscription"]


class OverlaySubscriptionHost(OverlayHost, Protocol):
    """The services of a graph for its subscriptions."""

    @property
    def registry(self) -> TypeRegistry:
        """The types whose stamps are read."""
        ...

    async def remove_subscription(self, subscription: OverlaySubscription) -> None:
        """Forget a subscription that was closed."""
        ...


class OverlaySubscription(SubscriptionBase[OverlaySubscriptionHost]):
    """Reads every publisher of its name that suits its profile, or those of one gateway, the target in its
    advertisement. ``qos=None`` adopts what they offer.
    """

    def __init__(
        self,
        graph: OverlaySubscriptionHost,
        advert: Advertisement,
        qos: QoS | None,
        callback: SampleCallback,
        feed: Feed,
    ) -> None:
        super().__init__(graph, advert.name, advert.type, qos, callback)
        self.endpoint = advert.endpoint
        self.advert, self.feed = advert, feed
        self._stamp: StampReader | None = None

    @property
    def reliable(self) -> bool:
        """Whether gaps are requested again."""
        return self.asked is None or self.asked.reliable

    @property
    def history(self) -> bool:
        """Whether earlier messages are wanted, if the publisher has them."""
        return self.asked is None or self.asked.transient_local

    def rematch(self) -> None:
        """Join the publishers that suit, leave the others."""
        offered: list[QoS] = []
        for stream in self.feed.streams.values():
            if self.advert.target not in (b"", stream.advert.gateway):
                continue
            if self._has_own(stream):
                stream.leave(self)
            elif stream.advert.qos is None or stream.advert.qos.satisfies(self.asked):
                stream.join(self)
                offered.append(stream.advert.qos or DEFAULT)
            else:
                stream.leave(self)
        self.adopt(offered)

    def _has_own(self, stream: PublisherStream) -> bool:
        """Return whether the gateway that publishes this for everybody publishes it for us alone as well, and we read
        that.
        """
        return not stream.advert.target and any(
            other.advert.target and other.advert.gateway == stream.advert.gateway and other.reads(self)
            for other in self.feed.streams.values()
        )

    def joined(self, stream: PublisherStream) -> None:
        """Note that a publisher has given its key."""
        if stream.advert.target:
            self.rematch()

    def received(self, stream: PublisherStream, items: Sequence[PacketItem]) -> None:
        """Deliver messages, in order."""
        if self.closed:
            return
        now = time.time_ns()
        if stream.advert.answers:
            self._asked(stream.advert, items)
        batch = [
            Sample(item.payload, self.type, now, item.origin, item.seq, bool(item.flags & RELAYED), 0) for item in items
        ]
        self.deliver(batch)

    def _asked(self, advert: Advertisement, items: Sequence[PacketItem]) -> None:
        """Note whose requests these are, so that the answers can go there."""
        asked = self._graph.node.askers.get(advert.answers)
        if asked is None:
            return
        if self._stamp is None:
            self._stamp = stamp_reader(self._graph.registry, self.type)
        for item in items:
            asked.asked(advert.gateway, self._stamp(item.payload))

    def overrun(self, count: int) -> None:
        """Count messages that were lost because the event loop was behind."""
        self._graph.drops[self.topic, Undelivered.BACKLOG] += count

    async def close(self) -> None:
        """Stop reading."""
        if self.closed:
            return
        self.closed = True
        for stream in self.feed.streams.values():
            stream.leave(self)
        await self._graph.remove_subscription(self)
