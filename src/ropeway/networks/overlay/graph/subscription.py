"""Subscribes to a topic in the overlay."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from ropeway.graph.base import Sample, SampleCallback, Undelivered
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.feed import Feed, PublisherStream
from ropeway.networks.overlay.graph.matching import matches
from ropeway.networks.overlay.packet_item import RELAYED, PacketItem
from ropeway.qos import DEFAULT, QoS, common_qos

if TYPE_CHECKING:
    from ropeway.networks.overlay.graph.graph import OverlayGraph

__all__ = ["OverlaySubscription"]

log = logging.getLogger("ropeway.overlay")


class OverlaySubscription:
    """Reads every publisher of its name that suits its profile. ``qos=None`` adopts what they offer."""

    def __init__(
        self, graph: OverlayGraph, advert: Advertisement, qos: QoS | None, callback: SampleCallback, feed: Feed
    ) -> None:
        self.topic, self.type, self.endpoint = advert.name, advert.type, advert.endpoint
        self.advert, self.feed = advert, feed
        self.closed = False
        self._graph = graph
        self._asked = qos
        self._qos = qos or DEFAULT
        self._callback = callback
        self._qos_callbacks: list[Callable[[QoS], None]] = []

    @property
    def qos(self) -> QoS:
        """The profile in use."""
        return self._qos

    @property
    def reliable(self) -> bool:
        """Whether gaps are requested again."""
        return self._asked is None or self._asked.reliable

    @property
    def history(self) -> bool:
        """Whether earlier messages are wanted, if the publisher has them."""
        return self._asked is None or self._asked.transient_local

    def on_qos(self, callback: Callable[[QoS], None]) -> None:
        """Call with the profile, now and whenever the adopted one changes."""
        self._qos_callbacks.append(callback)
        callback(self._qos)

    def rematch(self) -> None:
        """Join the publishers that suit, leave the others."""
        offered: list[QoS] = []
        for stream in self.feed.streams.values():
            if matches(stream.advert.qos, self._asked):
                stream.join(self)
                offered.append(stream.advert.qos or DEFAULT)
            else:
                stream.leave(self)
        if self._asked is None:
            qos = common_qos(offered, self._qos)
            if qos != self._qos:
                self._qos = qos
                for callback in self._qos_callbacks:
                    self._graph.guard(self.topic, callback, qos)

    def received(self, stream: PublisherStream, items: Sequence[PacketItem]) -> None:
        """Deliver messages, in order."""
        if self.closed:
            return
        now = time.time_ns()
        batch = [
            Sample(item.payload, self.type, now, item.origin, item.seq, bool(item.flags & RELAYED), 0) for item in items
        ]
        try:
            self._callback(batch)
        except Exception:  # a callback is somebody else's code
            self._graph.drops[self.topic, Undelivered.CALLBACK] += len(batch)
            log.exception("%s: a callback for %s failed", self._graph.name, self.topic)

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
