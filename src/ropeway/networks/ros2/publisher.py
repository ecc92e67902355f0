"""Publishes a topic through rclpy."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Final, Protocol

from ropeway.graph.base import Sample, Undelivered
from ropeway.graph.parts import PublisherBase
from ropeway.networks.ros2.host import Ros2Host
from ropeway.networks.ros2.rcl import RclError
from ropeway.networks.ros2.senders import Lane
from ropeway.qos import QoS

__all__ = ["Ros2Publisher"]

log = logging.getLogger("ropeway.ros2")

_WAITING: Final = 256  # messages, where the profile keeps fewer: what a burst may bring
_WAITING_ALL: Final = 8192
_WAITING_BYTES: Final = 64 << 20
_SHORTEST: Final = 4
_ACKED_S: Final = 0.5  # how long what was published last may take to arrive once the topic is withdrawn


class Ros2PublisherHost(Ros2Host, Protocol):
    """The services of a graph for its publishers."""

    def count_readers(self, publisher: Ros2Publisher) -> int:
        """Return how many readers of others are matched with a publisher."""
        ...

    async def withdraw(self, publisher: Ros2Publisher, lane: Lane) -> None:
        """Remove a closed publisher."""
        ...


class Ros2Publisher(PublisherBase[Ros2PublisherHost]):
    """Publishes CDR unchanged, in a thread, since a slow reader may block the writer."""

    def __init__(self, graph: Ros2PublisherHost, topic: str, type: str, qos: QoS, raw: Any) -> None:
        super().__init__(graph, topic, type, qos)
        self.raw = raw
        self.counted = 0  # the readers of others, as they were counted last
        participant = graph.participant
        depth = _WAITING_ALL if qos.history == "keep_all" else max(_WAITING, qos.depth)
        self._lane: Lane = participant.senders.lane(depth, _WAITING_BYTES, self._on_backlog)
        self._rcl, self._invalid = participant.rcl, participant.invalid_handle
        self._spinner = participant.spinner
        self._translated = graph.border.touches(type)
        self._warned = False
        self._last = 0.0

    def publish(self, sample: Sample) -> None:
        """Send, without waiting; what does not fit is dropped, oldest first, and counted."""
        if self.closed:
            self._graph.drops[self.topic, Undelivered.CLOSED] += 1
            return
        payload = sample.payload if type(sample.payload) is bytes else bytes(sample.payload)
        if self._translated:
            payload = self._graph.border.outgoing(self.type, payload)
        if len(payload) < _SHORTEST:
            self._graph.drops[self.topic, Undelivered.ENCODE] += 1
            return
        self._last = time.monotonic()
        self._lane.put(partial(self._send, payload), len(payload))

    def _send(self, payload: bytes) -> None:
        """Publish, in a thread."""
        try:
            with self.raw.handle:
                self._rcl.publish(self.raw.handle.pointer, payload)
        except self._invalid:
            self._spinner.push(self._on_refused, [(Undelivered.CLOSED, "")])
        except RclError as error:
            self._spinner.push(self._on_refused, [(Undelivered.WRITE, str(error))])

    def _on_refused(self, batch: list[tuple[Undelivered, str]]) -> None:
        for reason, text in batch:
            self._graph.drops[self.topic, reason] += 1
            if text and not self._warned:
                self._warned = True
                log.warning("%s: %s cannot be published: %s", self._graph.name, self.topic, text)

    def _on_backlog(self, count: int) -> None:
        self._graph.drops[self.topic, Undelivered.WRITE] += count

    @property
    def subscribers(self) -> int:
        """Return how many readers of others are matched now; those of our own gateway do not count."""
        return 0 if self.closed else self._graph.count_readers(self)

    def on_demand(self, callback: Callable[[int], None]) -> None:
        """See ``Publisher.on_demand``."""
        self.look()
        super().on_demand(callback)

    def look(self) -> None:
        """Count the readers again, and tell a change."""
        self.counted = self.subscribers
        self.set_subscribers(self.counted)

    async def close(self) -> None:
        """Withdraw the topic, once what was published is out."""
        if self.closed:
            return
        self.closed = True
        self._demand.clear()
        if self.qos.reliable and time.monotonic() - self._last < 2 * _ACKED_S:
            self._lane.put(self._settle)
        await self._graph.withdraw(self, self._lane)

    def _settle(self) -> None:
        """Let what was published last arrive, in a thread: some middlewares forget it with its publisher."""
        with contextlib.suppress(self._invalid), self.raw.handle:
            self._rcl.wait_acked(self.raw.handle.pointer, _ACKED_S)
