"""Decides what is sent to a broker next, when it can take it: the freshest, by priorities and shares.

Messages are encoded when it is their turn. Reliable ones wait for the acknowledgement of the broker, and are sent again
if the connection was lost before; what is only of the moment is not kept for a broker that is away.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import Any, Final, NamedTuple

from ropeway.delivery.outbox import Lost, Outbox, Queue
from ropeway.graph.base import Sample
from ropeway.graph.signal import Signal
from ropeway.limits import MQTT_IN_FLIGHT_BYTES, MQTT_UNSENT_BYTES
from ropeway.networks.mqtt.connection import MqttConnection

__all__ = ["MqttOutgoing", "MqttPayload", "MqttStream"]

_AWAY_NS: Final = 10_000_000_000  # a reliable message waits so long for a broker that is away

_TRIES: Final = 3  # connections that are lost with the same message under way, before it is given up


class MqttPayload(NamedTuple):
    """A message as the broker gets it."""

    topic: str
    payload: bytes
    properties: Any


class MqttStream:
    """The messages of one publisher. ``encode`` returns ``None`` for one that cannot be sent, which it has counted."""

    def __init__(
        self,
        queue: Queue[Sample],
        encode: Callable[[Sample], MqttPayload | None],
        *,
        reliable: bool,
        retain: bool,
        on_refused: Callable[[str], None],
    ) -> None:
        self.queue, self.encode = queue, encode
        self.reliable, self.retain, self.on_refused = reliable, retain, on_refused
        self.last: Sample | None = None  # of a retained topic: the broker may have forgotten it
        self.refused = ""  # why the broker did not take the last message that it answered

    @property
    def acknowledged(self) -> bool:
        """Whether the broker says that it has a message."""
        return self.reliable or self.retain


class _InFlight(NamedTuple):
    stream: MqttStream
    sample: Sample
    size: int


class MqttOutgoing:
    """Holds what waits for the broker of one connection, and what it has not acknowledged."""

    def __init__(self, connection: MqttConnection, clock: Callable[[], int] = time.time_ns) -> None:
        self._connection, self._clock = connection, clock
        self._outbox: Outbox[Sample] = Outbox()
        self._streams: dict[int, MqttStream] = {}  # by the numbers of their queues
        self._in_flight: OrderedDict[int, _InFlight] = OrderedDict()
        self._in_flight_bytes = 0
        self._suspected: tuple[tuple[bytes, int], int] = ((b"", 0), 0)
        self._pumping = False
        self.changed = Signal()  # something has left, been acknowledged, or lost

    @property
    def waiting(self) -> int:
        """The number of messages that wait or are not acknowledged."""
        return self._outbox.messages + len(self._in_flight)

    def open(self, stream: MqttStream) -> None:
        """Make a publisher ready to send."""
        self._outbox.open(stream.queue)
        self._streams[stream.queue.number] = stream

    def close(self, stream: MqttStream) -> None:
        """Take a publisher out; what waits of it is lost and counted."""
        self._outbox.close(stream.queue)
        self._streams.pop(stream.queue.number, None)

    def of(self, stream: MqttStream) -> int:
        """Return how many messages of a publisher wait or are not acknowledged."""
        return len(stream.queue.waiting) + sum(entry.stream is stream for entry in self._in_flight.values())

    def put(self, stream: MqttStream, sample: Sample) -> None:
        """Send a message, now or when the broker takes it."""
        queue = stream.queue
        if stream.retain:
            stream.last = sample
        if not self._connection.connected and not stream.acknowledged:
            queue.lost[Lost.UNSENT] += 1
            return
        if self._outbox.bytes + len(sample.payload) > MQTT_UNSENT_BYTES and not self._outbox.full(
            queue, len(sample.payload)
        ):
            queue.lost[Lost.OVERFLOW] += 1  # others wait, and what is there of this topic is not older
            return
        self._outbox.put(queue, sample)
        self.pump()

    def pump(self) -> None:
        """Send what the broker takes."""
        if self._pumping:  # the connection says that it takes more while it is given something
            return
        self._pumping = True
        try:
            while self._connection.free and self._has_room() and self._send_next():
                pass
        finally:
            self._pumping = False
        if not self._outbox.messages:
            self.changed.notify()

    def published(self, number: int, refused: str) -> None:
        """Note that the broker has a message, or why it refuses it."""
        entry = self._in_flight.pop(number, None)
        if entry is None:
            return
        self._in_flight_bytes -= entry.size
        entry.stream.refused = refused
        if refused:
            entry.stream.on_refused(refused)
        self.pump()
        self.changed.notify()

    def lose(self) -> None:
        """Note that the connection is lost: what was not acknowledged goes to the front again.

        A broker takes messages in turn, so the oldest of them is the one on which it may have closed the connection;
        it is given up when that has happened several times.
        """
        lost, self._in_flight, self._in_flight_bytes = list(self._in_flight.values()), OrderedDict(), 0
        if lost and self._suspect(lost[0].sample):
            head = lost.pop(0)
            head.stream.queue.lost[Lost.UNSENT] += 1
            if head.stream.last is head.sample:
                head.stream.last = None
        unacknowledged: dict[int, list[Sample]] = {}
        for entry in lost:
            unacknowledged.setdefault(entry.stream.queue.number, []).append(entry.sample)
        for number, stream in list(self._streams.items()):
            self._requeue(stream, unacknowledged.get(number, []), keep=stream.acknowledged)
        self.changed.notify()

    def _suspect(self, sample: Sample) -> bool:
        """Return whether connections were lost several times in turn with a message as the oldest under way."""
        key = (sample.origin, sample.seq)
        self._suspected = (key, self._suspected[1] + 1 if key == self._suspected[0] else 1)
        return self._suspected[1] >= _TRIES

    def resume(self) -> None:
        """Send again what the broker may have forgotten, and what has waited for it and is not too old."""
        oldest_ns = self._clock() - _AWAY_NS
        for stream in list(self._streams.values()):
            last = stream.last
            if stream.retain and last is not None and last not in stream.queue.waiting:
                self._requeue(stream, [last], keep=True)
            elif not stream.retain:
                self._requeue(stream, [], keep=True, oldest_ns=oldest_ns)
        self.pump()

    def _requeue(self, stream: MqttStream, first: Iterable[Sample], *, keep: bool, oldest_ns: int = 0) -> None:
        """Make ``first`` and then what waits the queue of a stream, as far as it is to be kept and not too old."""
        queue = stream.queue
        every = [*first, *self._outbox.release(queue)]
        kept = [sample for sample in every if keep and sample.stamp_ns >= oldest_ns]
        queue.lost[Lost.UNSENT] += len(every) - len(kept)
        del self._streams[queue.number]
        self.open(stream)
        for sample in kept:
            self._outbox.put(queue, sample)

    def _has_room(self) -> bool:
        count = len(self._in_flight)
        return not count or (count < self._connection.limits.in_flight and self._in_flight_bytes < MQTT_IN_FLIGHT_BYTES)

    def _send_next(self) -> bool:
        """Send one message; return whether there was one and the connection took it."""
        outbox = self._outbox
        for priority in outbox.lanes():
            taken = outbox.take(priority, self._clock())
            if taken is not None:
                break
        else:
            return False
        queue, sample = taken
        stream = self._streams[queue.number]
        encoded = stream.encode(sample)
        sent = encoded is None or self._hand_over(stream, sample, encoded)
        if encoded is not None:
            outbox.served(queue, len(encoded.payload))
        outbox.done(queue)
        if not sent:
            self._requeue(stream, [sample], keep=stream.acknowledged)
        return sent

    def _hand_over(self, stream: MqttStream, sample: Sample, encoded: MqttPayload) -> bool:
        """Give a message to the connection; return whether it has taken it."""
        qos = 1 if stream.acknowledged else 0
        topic, payload, properties = encoded
        number = self._connection.publish(topic, payload, qos, stream.retain, properties)
        if number is None:
            return False
        if min(qos, self._connection.limits.qos):
            self._in_flight[number] = _InFlight(stream, sample, len(payload))
            self._in_flight_bytes += len(payload)
        return True
