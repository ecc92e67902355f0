"""Delivers a topic to one of its subscribers in this process."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

from ropeway.graph.base import SampleCallback, Undelivered
from ropeway.logs import failed
from ropeway.networks.ros1.reader import Batch, TopicReader
from ropeway.qos import DEFAULT, LATCHED, QoS, adopted

__all__ = ["Ros1Subscription"]

log = logging.getLogger("ropeway.ros1")


class Ros1Subscription:
    """A topic read from a ``Ros1Graph``: see ``ropeway.graph.base.Subscription``."""

    def __init__(self, reader: TopicReader, qos: QoS | None, callback: SampleCallback) -> None:
        self.topic, self.type = reader.topic, reader.type
        self.closed = False
        self._reader = reader
        self._asked = qos
        self._qos = qos or DEFAULT
        self._callback = callback
        self._qos_callbacks: list[Callable[[QoS], None]] = []
        self._missed = {link for link in reader.links if link.last is not None}
        reader.users.append(self)
        if self._missed:
            asyncio.get_running_loop().call_soon(self._catch_up)
        self.links_changed()

    @property
    def qos(self) -> QoS:
        """The profile in use."""
        return self._qos

    def on_qos(self, callback: Callable[[QoS], None]) -> None:
        """Call with the profile, now and when the adopted one changes."""
        self._qos_callbacks.append(callback)
        callback(self._qos)

    def links_changed(self) -> None:
        """Adopt what the publishers that are connected offer."""
        links = self._reader.links
        if not links:
            return
        qos = adopted(self._asked, (LATCHED if link.latched else DEFAULT for link in links), self._qos)
        if qos != self._qos:
            self._qos = qos
            for callback in self._qos_callbacks:
                callback(qos)

    def _catch_up(self) -> None:
        """Take what was latched before this subscription came, unless something newer was taken since."""
        for link in list(self._missed):
            if link.connected and (batch := link.latest) is not None:
                self.take(batch)
        self._missed.clear()

    def take(self, batch: Batch) -> None:
        """Take messages; see ``Consumer``."""
        self._missed.discard(batch.link)
        samples = batch.samples
        if self.closed or not samples:
            return
        try:
            self._callback(samples)
        except Exception:  # a callback is somebody else's code
            node = self._reader.node
            node.drops[self.topic, Undelivered.CALLBACK] += len(samples)
            failed(log, "%s: a callback for %s failed", node.graph, self.topic)

    async def close(self) -> None:
        """Stop reading."""
        if not self.closed:
            self.closed = True
            await self._reader.leave(self)
