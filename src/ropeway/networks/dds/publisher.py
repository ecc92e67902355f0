"""Publishes a topic on DDS."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from ropeway.errors import TypesError
from ropeway.graph.base import Sample, Undelivered
from ropeway.networks.dds.raw_endpoints import RawWriter
from ropeway.qos import QoS
from ropeway.types.translation import Translate

if TYPE_CHECKING:
    from ropeway.networks.dds.graph import DdsGraph

__all__ = ["DdsPublisher"]


class DdsPublisher:
    """Publishes what it is given as it is, under the source timestamp ``sample.seq`` where there is one.

    With a lifespan the source timestamp is the time of now, because receivers count the lifespan from it.
    """

    def __init__(self, graph: DdsGraph, topic: str, type: str, qos: QoS, outward: Translate | None = None) -> None:
        self.topic, self.type, self.qos = topic, type, qos
        self._graph = graph
        self._outward = outward  # brings messages into the layout of another distribution
        self._keep_stamp = qos.lifespan_s is None
        self._writer: RawWriter | None = None
        self._subscribers = 0
        self._demand: list[Callable[[int], None]] = []

    def bind(self, writer: RawWriter) -> None:
        """Write through ``writer`` from now on."""
        self._writer = writer
        self._write = writer.write if self._outward is None else self._write_translated

    def publish(self, sample: Sample) -> None:
        """Send, without waiting; what DDS does not take is counted."""
        self._write(sample.payload, sample.seq if self._keep_stamp else 0)

    def _write_translated(self, payload: bytes, stamp_ns: int) -> None:
        assert self._writer is not None
        assert self._outward is not None
        try:
            translated = self._outward(payload)
        except TypesError:
            self.on_refused(Undelivered.ENCODE)
            return
        self._writer.write(translated, stamp_ns)

    def on_refused(self, reason: Undelivered) -> None:
        """Count a message that was not sent."""
        self._graph.drops[self.topic, reason] += 1

    @property
    def subscribers(self) -> int:
        """The number of matched readers of others; those of our own gateway do not count."""
        return self._subscribers

    def on_demand(self, callback: Callable[[int], None]) -> None:
        """Call with the number of subscribers, now and at each change."""
        self._demand.append(callback)
        callback(self._subscribers)

    def on_count(self, count: int) -> None:
        """Take the number of readers from DDS."""
        if count == self._subscribers:
            return
        self._subscribers = count
        for callback in self._demand:
            self._graph.guard(self.topic, callback, count)

    async def close(self) -> None:
        """Withdraw the topic."""
        self._demand.clear()
        self._subscribers = 0
        await self._graph.withdraw(self, self._writer)
