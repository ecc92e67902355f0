"""ropeway.networks.mqtt.outgoing: what is sent to a broker next, and what happens when it goes away."""

from __future__ import annotations

from typing import Any

from ropeway.delivery.outbox import Lost, Queue
from ropeway.graph.base import Sample
from ropeway.limits import MQTT_IN_FLIGHT
from ropeway.networks.mqtt.connection import BrokerLimits
from ropeway.networks.mqtt.outgoing import MqttOutgoing, MqttPayload, MqttStream


class Line:
    """A connection that takes what it is given while ``free``, and numbers it."""

    def __init__(self) -> None:
        self.free = self.connected = True
        self.limits = BrokerLimits()
        self.sent: list[tuple[str, bytes, int, bool]] = []

    def publish(self, topic: str, payload: bytes, qos: int, retain: bool, properties: object) -> int | None:
        if not self.connected:
            return None
        self.sent.append((topic, payload, qos, retain))
        return len(self.sent)

    @property
    def payloads(self) -> list[bytes]:
        return [payload for _, payload, _, _ in self.sent]


class Sending:
    """What goes out over a line, by a clock of its own."""

    def __init__(self) -> None:
        self.line = Line()
        self.now_ns = 0
        self.refused: list[str] = []
        self.out = MqttOutgoing(self.line, lambda: self.now_ns)  # type: ignore[arg-type]

    def stream(self, *, reliable: bool = True, retain: bool = False, depth: int = 10, **options: Any) -> MqttStream:
        queue: Queue[Sample] = Queue("/t", depth=depth, **options)
        queue.latched = True
        made = MqttStream(
            queue,
            lambda sample: MqttPayload("t", sample.payload, None) if sample.payload != b"bad" else None,
            reliable=reliable,
            retain=retain,
            on_refused=self.refused.append,
        )
        self.out.open(made)
        return made

    def put(self, stream: MqttStream, *payloads: bytes) -> None:
        for payload in payloads:
            number = int.from_bytes(payload[:8], "big") + 1
            self.out.put(stream, Sample(payload, "T", self.now_ns, bytes(16), number))

    def acknowledge(self) -> None:
        for number in range(len(self.line.sent) + 1):
            self.out.published(number, "")


def test_qos() -> None:
    """Reliable and retained messages are acknowledged, others are not."""
    sending = Sending()
    for reliable, retain in ((True, False), (False, True), (False, False)):
        sending.put(sending.stream(reliable=reliable, retain=retain), b"x")
    assert [(qos, retain) for _, _, qos, retain in sending.line.sent] == [(1, False), (1, True), (0, False)]
    assert sending.out.waiting == 2


def test_window() -> None:
    """No more messages are under way than the broker takes; the rest waits, and goes as it acknowledges."""
    sending = Sending()
    stream = sending.stream(depth=1000)
    sending.put(stream, *(b"%d" % number for number in range(200)))
    assert len(sending.line.sent) == MQTT_IN_FLIGHT
    sending.line.limits = BrokerLimits(in_flight=5)
    sending.acknowledge()
    assert len(sending.line.sent) == MQTT_IN_FLIGHT + 5
    assert sending.out.of(stream) == 200 - MQTT_IN_FLIGHT


def test_freshest() -> None:
    """While the broker takes nothing, the newest messages wait and the others are counted."""
    sending = Sending()
    stream, urgent = sending.stream(reliable=False, depth=2), sending.stream(priority=0)
    sending.line.free = False
    sending.put(stream, b"1", b"2", b"3", b"4")
    sending.put(urgent, b"now")
    sending.line.free = True
    sending.out.pump()
    assert sending.line.payloads == [b"now", b"3", b"4"]
    assert stream.queue.lost == {Lost.REPLACED: 2}


def test_not_encodable() -> None:
    """A message that cannot be encoded costs no other."""
    sending = Sending()
    sending.put(sending.stream(), b"bad", b"good")
    assert sending.line.payloads == [b"good"]


def test_refused() -> None:
    """A message that the broker refuses is told, and its topic is refused until it takes one."""
    sending = Sending()
    stream = sending.stream()
    sending.put(stream, b"1", b"2")
    sending.out.published(1, "Not authorized")
    assert (stream.refused, sending.refused) == ("Not authorized", ["Not authorized"])
    sending.out.published(2, "")
    sending.out.published(99, "whatever")
    assert stream.refused == ""


def test_lost_connection() -> None:
    """What was not acknowledged goes again first, what is of the moment is given up, and what is too old as well."""
    sending = Sending()
    reliable, moment = sending.stream(), sending.stream(reliable=False)
    sending.put(reliable, b"1", b"2")
    sending.line.free = False
    sending.put(moment, b"x")
    sending.line.connected = False
    sending.out.lose()
    sending.put(reliable, b"3")
    sending.put(moment, b"y")
    assert moment.queue.lost == {Lost.UNSENT: 2}
    sending.line.connected = sending.line.free = True
    sending.out.resume()
    assert sending.line.payloads == [b"1", b"2", b"1", b"2", b"3"]
    sending.out.lose()
    sending.now_ns = 11_000_000_000
    sending.out.resume()
    assert reliable.queue.lost == {Lost.UNSENT: 3}


def test_last_value() -> None:
    """The last value of a retained topic is sent on each new connection, once."""
    sending = Sending()
    stream = sending.stream(retain=True, depth=1)
    sending.put(stream, b"old", b"last")
    sending.acknowledge()
    for count in (3, 4):
        sending.out.lose()
        sending.now_ns += 100_000_000_000
        sending.out.resume()
        sending.acknowledge()
        assert sending.line.payloads[2:] == [b"last"] * (count - 2)


def test_message_that_closes_connections() -> None:
    """A message on which a broker closes the connection again and again is given up; those behind it are sent."""
    sending = Sending()
    stream = sending.stream(depth=10)
    sending.put(stream, b"poison", b"good")
    for _ in range(3):
        sending.out.lose()
        sending.out.resume()
    assert sending.line.payloads == [b"poison", b"good"] * 3 + [b"good"]
    assert stream.queue.lost == {Lost.UNSENT: 1}


def test_connection_that_breaks_while_it_is_given_something() -> None:
    """A reliable message that the connection did not take waits for the next."""
    sending = Sending()
    stream = sending.stream()
    sending.line.connected = False
    sending.put(stream, b"1")
    sending.line.connected = True
    sending.out.resume()
    assert sending.line.payloads == [b"1"]
    sending.out.close(stream)
    assert sending.out.of(stream) == 1
