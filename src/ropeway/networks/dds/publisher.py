"""Publishes a topic on DDS."""

from __future__ import annotations

from typing import Protocol

from ropeway.errors import TypesError
from ropeway.graph.base import Sample, Undelivered
from ropeway.graph.host import Host
from ropeway.graph.parts import PublisherBase
from ropeway.networks.dds.raw_endpoints import RawWriter
from ropeway.qos import QoS
from ropeway.types.translation import Translate

__all__ = ["DdsPublisher", "DdsPublisherHost"]


class DdsPublisherHost(Host, Protocol):
    """The services of a graph for its publishers."""

    async def withdraw(self, publisher: DdsPublisher, writer: RawWriter | None) -> None:
        """Forget a publisher that was closed, and delete its writer."""
        ...


class DdsPublisher(PublisherBase[DdsPublisherHost]):
    """Publishes what it is given as it is, under the source timestamp ``sample.seq`` where there is one.

    With a lifespan the source timestamp is the time of now, because receivers count the lifespan from it.
    """

    def __init__(
        self, graph: DdsPublisherHost, topic: str, type: str, qos: QoS, outward: Translate | None = None
    ) -> None:
        super().__init__(graph, topic, type, qos)
        self._outward = outward  # brings messages into the layout of another distribution
        self._keep_stamp = qos.lifespan_s is None
        self._writer: RawWriter | None = None

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

    async def close(self) -> None:
        """Withdraw the topic."""
        self.closed = True
        self._demand.clear()
        self.set_subscribers(0)
        await self._graph.withdraw(self, self._writer)
