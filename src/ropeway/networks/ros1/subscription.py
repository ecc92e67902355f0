"""Delivers a topic to one of its subscribers in this process."""

from __future__ import annotations

import asyncio

from ropeway.graph.base import SampleCallback
from ropeway.graph.host import Host
from ropeway.graph.parts import SubscriptionBase
from ropeway.networks.ros1.reader import Batch, TopicReader
from ropeway.qos import DEFAULT, LATCHED, QoS

__all__ = ["Ros1Subscription"]


class Ros1Subscription(SubscriptionBase[Host]):
    """A topic read from a ``Ros1Graph``: see ``ropeway.graph.base.Subscription``."""

    def __init__(self, reader: TopicReader, qos: QoS | None, callback: SampleCallback) -> None:
        super().__init__(reader.node.graph, reader.topic, reader.type, qos, callback)
        self._reader = reader
        self._missed = {link for link in reader.links if link.last is not None}
        reader.users.append(self)
        if self._missed:
            asyncio.get_running_loop().call_soon(self._catch_up)
        self.links_changed()

    def links_changed(self) -> None:
        """Adopt what the publishers that are connected offer."""
        if links := self._reader.links:
            self.adopt(LATCHED if link.latched else DEFAULT for link in links)

    def _catch_up(self) -> None:
        """Take what was latched before this subscription came, unless something newer was taken since."""
        for link in list(self._missed):
            if link.connected and (batch := link.latest) is not None:
                self.take(batch)
        self._missed.clear()

    def take(self, batch: Batch) -> None:
        """Take messages; see ``Consumer``."""
        self._missed.discard(batch.link)
        if not self.closed:
            self.deliver(batch.samples)

    async def close(self) -> None:
        """Stop reading."""
        if not self.closed:
            self.closed = True
            await self._reader.leave(self)
