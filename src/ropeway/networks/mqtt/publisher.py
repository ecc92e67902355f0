"""Publishes a topic to a broker."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Final, Protocol

from ropeway import aio
from ropeway.delivery.outbox import Lost, Queue
from ropeway.graph.base import SEQ_NONE, Delivery, Sample, Undelivered
from ropeway.graph.host import Host
from ropeway.graph.link_parts import LinkStatistics
from ropeway.graph.parts import PublisherBase
from ropeway.limits import MQTT_UNSENT_BYTES, MQTT_UNSENT_RELIABLE_BYTES
from ropeway.networks.mqtt.maps import MqttMap, form_of
from ropeway.networks.mqtt.outgoing import MqttPayload, MqttStream
from ropeway.networks.mqtt.wire import PublishProperties
from ropeway.qos import QoS
from ropeway.tasks import describe
from ropeway.types.forms import FAILURES

if TYPE_CHECKING:
    from ropeway.fault_log import FaultLog
    from ropeway.graph.deduplication import Seen
    from ropeway.networks.mqtt.connection import MqttConnection
    from ropeway.networks.mqtt.outgoing import MqttOutgoing
    from ropeway.types import TypeRegistry

__all__ = ["MqttPublisher", "MqttPublisherHost"]

_LEAVE_S: Final = 2.0  # how long what waits may take when its publisher closes
_HEAD_BYTES: Final = 512  # of a packet, beside its topic: properties with the longest type


class MqttPublisherHost(Host, Protocol):
    """The services of a graph for its publishers."""

    registry: TypeRegistry
    fault_log: FaultLog
    origin: bytes
    connection: MqttConnection
    outgoing: MqttOutgoing

    def had(self, topic: str) -> Seen | None:
        """Return what has come from a topic of the broker, which need not go back, ``None`` if it is not read."""
        ...

    def sent(self, topic: str, payload: bytes) -> None:
        """Note what goes to a topic, where the broker may send it back."""
        ...

    def withdraw(self, publisher: MqttPublisher) -> None:
        """Forget a publisher that was closed."""
        ...


class MqttPublisher(PublisherBase[MqttPublisherHost]):
    """A ROS topic that is published as ``target`` to a broker; who reads it there is not known.

    Reliable topics have QoS 1, others QoS 0; the last message of a transient-local one is retained.
    """

    def __init__(
        self,
        graph: MqttPublisherHost,
        topic: str,
        type: str,
        qos: QoS,
        target: str,
        map: MqttMap | None,
        delivery: Delivery,
    ) -> None:
        super().__init__(graph, topic, type, qos)
        self._subscribers = None
        self.target = target
        self._form_name, self._form = form_of(map, type, graph.registry)
        lifespan_s = delivery.lifespan_s if delivery.lifespan_s is not None else qos.lifespan_s
        self._properties = PublishProperties(type, self._form_name, lifespan_s)
        retain = qos.transient_local or (map is not None and map.latched)
        kept = None if qos.history == "keep_all" else 1 if retain or not qos.reliable else max(qos.depth, 1)
        queue: Queue[Sample] = Queue(
            topic,
            priority=delivery.priority,
            depth=delivery.depth or kept,
            lifespan_ns=None if lifespan_s is None else int(lifespan_s * 1e9),
            weight=delivery.weight,
            limit_bytes=MQTT_UNSENT_BYTES if retain else MQTT_UNSENT_RELIABLE_BYTES,
        )
        queue.latched = retain or qos.reliable  # as many as the profile keeps, and not the newest alone
        self._stream = MqttStream(queue, self._encode, reliable=qos.reliable, retain=retain, on_refused=self._refused)
        graph.outgoing.open(self._stream)

    def publish(self, sample: Sample) -> None:
        """Send, now or when the broker takes it; what it has sent us does not go back."""
        graph = self._graph
        if self.closed:
            graph.drops[self.topic, Undelivered.CLOSED] += 1
            return
        if sample.seq == SEQ_NONE:
            sample = self._numbered(sample, graph.origin)
        elif not sample.stamp_ns:
            sample = Sample(sample.payload, self.type, time.time_ns(), sample.origin, sample.seq, sample.relayed)
        had = graph.had(self.target)
        if had is not None and had.has(sample):
            return
        graph.outgoing.put(self._stream, sample)

    def statistics(self) -> LinkStatistics:
        """See ``LinkedPublisher.statistics``."""
        lost = {reason.value: count for reason, count in self._stream.queue.lost.items() if count}
        return LinkStatistics(self._form_name, lost, refused=self.refused)

    @property
    def refused(self) -> str:
        """See ``Refusable.refused``."""
        return self._stream.refused

    @property
    def waiting(self) -> int:
        """See ``Draining.waiting``."""
        return self._graph.outgoing.of(self._stream)

    async def arrived(self) -> None:
        """See ``Draining.arrived``: the broker has acknowledged it, or it has left."""
        graph = self._graph
        while self.waiting and graph.connection.connected:
            await graph.outgoing.changed.wait()

    async def close(self) -> None:
        """Withdraw the topic, after what waits was sent; a retained message stays with the broker."""
        if self.closed:
            return
        self.closed = True
        with contextlib.suppress(TimeoutError):
            async with aio.timeout(_LEAVE_S):
                await self.arrived()
        self._graph.outgoing.close(self._stream)
        self._graph.withdraw(self)

    def _encode(self, sample: Sample) -> MqttPayload | None:
        graph = self._graph
        try:
            payload = self._form.text(bytes(sample.payload))
        except FAILURES as error:
            graph.drops[self.topic, Undelivered.ENCODE] += 1
            graph.fault_log.note("message", self.target, f"it is not passed on: {describe(error)}")
            return None
        if payload is None:
            return None
        connection = graph.connection
        properties = self._properties.of(sample) if connection.plan.five else None
        if len(payload) + len(self.target) + _HEAD_BYTES > connection.limits.packet_bytes:
            self._stream.queue.lost[Lost.ENCODE] += 1
            graph.fault_log.note("size", self.target, f"{len(payload)} bytes are more than the broker takes")
            return None
        if not connection.plan.five:
            graph.sent(self.target, payload)
        return MqttPayload(self.target, payload, properties)

    def _refused(self, why: str) -> None:
        """Note that the broker does not take a message."""
        self._graph.drops[self.topic, Undelivered.WRITE] += 1
        self._graph.fault_log.note("message", self.target, f"the broker refuses it: {why}")
