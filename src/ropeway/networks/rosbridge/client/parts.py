"""Publishers and subscriptions on the far end of a link. They outlive connections: each new one announces them."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ropeway.delivery.outbox import Lost
from ropeway.errors import MessageTooBig, TypesError
from ropeway.graph.base import SEQ_NONE, Delivery, Sample, SampleCallback, Undelivered, new_origin
from ropeway.graph.history import History
from ropeway.graph.link_parts import NO_LOSSES, FarFigures, LinkStatistics
from ropeway.graph.parts import PublisherBase, SubscriptionBase
from ropeway.graph.peer_answer import Answers
from ropeway.networks.rosbridge.client.host import LinkGraph
from ropeway.networks.rosbridge.link.inbound import Inbound
from ropeway.networks.rosbridge.protocol import codec as wire_codec
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY, ROSBRIDGE, ROSGW
from ropeway.qos import QoS

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.link.peer import Channel, Peer
    from ropeway.types import MessageCodec

__all__ = ["RemotePublisher", "RemoteSubscription"]

log = logging.getLogger("ropeway.rosbridge")


class RemotePublisher(PublisherBase[LinkGraph]):
    """A topic that we publish on the far graph."""

    def __init__(self, graph: LinkGraph, topic: str, type: str, qos: QoS, delivery: Delivery) -> None:
        super().__init__(graph, topic, type, qos)
        self.graph, self.delivery = graph, delivery
        self.number = graph.table.next_number()
        self.id = f"advertise:{topic}:{self.number}"
        self.channel: Channel | None = None
        self.lost: Counter[Lost] = Counter()
        self.sent = self.sent_bytes = 0
        self.answers = Answers()
        self.far: FarFigures | None = None
        self.remote_delay_s: float | None = None  # from this gateway's reception to the far one's
        self._gid = new_origin()
        self._gone: Callable[[Any], None] | None = None
        self._history = History(qos)
        self._latched = qos.transient_local
        self._translated = graph.border.touches(type)

    def publish(self, sample: Sample) -> None:
        """Let a message wait for the link; with the link down it is lost and counted, unless it is latched."""
        if self.closed:
            self.graph.drops[self.topic, Undelivered.CLOSED] += 1
            return
        if sample.seq == SEQ_NONE:
            sample = self._numbered(sample, self._gid)
        if self._translated:
            try:
                sample = sample.carrying(self.graph.border.outgoing(self.type, sample.payload))
            except TypesError:
                self.graph.drops[self.topic, Undelivered.ENCODE] += 1
                return
        if self._latched:
            self._history.add(sample)
            if self.channel is None:
                return  # sent when the link is back
        elif self.channel is None:
            self.lost[Lost.UNSENT] += 1
            return
        elif self._subscribers == 0:
            return  # nobody reads it there
        echo = self.graph.table.echoes.get(self.topic)
        if echo is not None:
            echo.sent(sample.payload)
        self.channel.put(sample)

    def on_gone(self, callback: Callable[[Any], None] | None) -> None:
        """See ``Departing.on_gone``."""
        self._gone = callback
        if self.channel is not None:
            self.channel.gone = callback

    @property
    def waiting(self) -> int:
        """The number of messages that wait for the link, with the one that is being sent."""
        return 0 if self.channel is None else len(self.channel.queue.waiting) + self.channel.queue.under_way

    async def arrived(self) -> None:
        """See ``Draining.arrived``."""
        peer, channel = self.graph.peer, self.channel
        reached = None if peer is None or channel is None else peer.express.mark(channel)
        if reached is not None:
            await reached

    @property
    def refused(self) -> str:
        """The reason why the far side does not take the topic, ``""`` if it does."""
        return self.answers.reason

    def on_answer(self, callback: Callable[[str], None]) -> None:
        """See ``Answering.on_answer``."""
        self.answers.on_answer(callback)

    def connected(self, peer: Peer) -> None:
        """Announce the topic on a new connection."""
        delivery = self.delivery
        plain = peer.dialect is not ROPEWAY
        encoding = delivery.encoding
        if plain:
            encoding = self.graph.plain_server.encoding(peer, self.topic, self.type, encoding)
            if self.graph.spelling.is_ros1:
                encoding = "none"
        extra: dict[str, Any] | None = None
        self.set_subscribers(None if plain else 0)  # a gateway tells at once how many read
        if not plain:
            extra = {"channel": self.number, **self.graph.type_note(self.type)}
        self.channel = peer.open_channel(
            self.number,
            self.topic,
            self.type,
            encoding=encoding,
            priority=delivery.priority,
            depth=queue_depth(delivery, self.qos),
            lifespan_s=delivery.lifespan_s,
        )
        if self.channel.codec is not None:
            self.channel.codec = self.graph.spelling.codec(self.type)
        self.channel.queue.lost = self.lost
        self.channel.queue.weight = delivery.weight
        self.channel.queue.latched = self.qos.latched
        self.channel.gone = self._gone
        rosgw = peer.dialect is ROSGW
        peer.send(
            ops.Advertise(
                id=self.id,
                topic=self.topic,
                type=self.graph.spelling.type_name(self.type),
                latch=plain and not rosgw and self.qos.latched,  # for servers that do not know qos
                queue_size=max(self.qos.depth, 1) if plain and not rosgw else 100,
                qos=None if rosgw else self.qos.to_json(),
                compression=encoding if rosgw and encoding != "none" else None,
                ropeway=extra,
            )
        )
        for sample in self._history.replay():
            self.channel.put(sample)
        if plain:
            self.answers.tell("")  # a server that has something against it does not say so

    def disconnected(self) -> None:
        """Let go of the connection, which is gone."""
        self._collect()
        self.channel = None
        self.set_subscribers(0)

    def announce_anew(self, peer: Peer) -> None:
        """Announce the topic once more: its type has another name there."""
        if self.channel is not None:
            self.channel.close()
        self.disconnected()
        self.connected(peer)

    def statistics(self) -> LinkStatistics:
        """See ``LinkedPublisher.statistics``."""
        encoding = None if self.channel is None else self.channel.used
        lost = {reason.value: n for reason, n in self.lost.items() if n} if self.lost else NO_LOSSES
        return LinkStatistics(encoding, lost, self.remote_delay_s, self.refused)

    def traffic(self) -> tuple[int, int]:
        """Return the messages and bytes sent, over all connections."""
        live = (self.channel.sent, self.channel.sent_bytes) if self.channel is not None else (0, 0)
        return self.sent + live[0], self.sent_bytes + live[1]

    def _collect(self) -> None:
        if self.channel is not None:
            self.sent += self.channel.sent
            self.sent_bytes += self.channel.sent_bytes

    async def close(self) -> None:
        """Withdraw the topic."""
        if self.closed:
            return
        self.closed = True
        self.graph.table.forget(self.number, self.topic)
        if self.channel is not None:
            peer = self.graph.peer
            assert peer is not None
            peer.pump()
            self._collect()
            self.channel.close()
            self.channel = None
            peer.send(ops.Unadvertise(id=self.id, topic=self.topic))


class RemoteSubscription(Inbound, SubscriptionBase[LinkGraph]):
    """A topic that we read from the far graph."""

    def __init__(
        self,
        graph: LinkGraph,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        delivery: Delivery,
    ) -> None:
        SubscriptionBase.__init__(self, graph, topic, type, qos, callback)
        self._translated = graph.border.touches(type)
        Inbound.__init__(self, type, None, self._translate if self._translated else callback, used="none")
        self.graph, self.delivery = graph, delivery
        self.number = graph.table.next_number()
        self.id = f"subscribe:{topic}:{self.number}"
        self.answers = Answers()
        self.far: FarFigures | None = None
        self._codec: MessageCodec | None = None
        self._plain_origin = new_origin()
        self._plain_seq = 0

    @property
    def encoding(self) -> str:
        """See ``Encoded.encoding``: until a message has come, that which was asked for."""
        return self.used

    @property
    def refused(self) -> str:
        """The reason why the far side does not give the topic, ``""`` if it does."""
        return self.answers.reason

    def on_answer(self, callback: Callable[[str], None]) -> None:
        """See ``Answering.on_answer``."""
        self.answers.on_answer(callback)

    def adopted(self, qos: QoS) -> None:
        """Take the profile that the far graph uses."""
        if self.asked is None:
            self.set_qos(qos)

    def connected(self, peer: Peer) -> None:
        """Ask for the topic on a new connection."""
        delivery = self.delivery
        self._peer = peer
        peer.receivers[self.number] = self.arrived
        encoding = delivery.encoding
        extra: dict[str, Any] | None = None
        if peer.dialect is ROPEWAY:
            extra = {"channel": self.number, "priority": delivery.priority, **self.graph.type_note(self.type)}
            if delivery.weight != 1.0:
                extra["weight"] = delivery.weight
            for key in ("rate_hz", "lifespan_s", "depth"):
                if (value := getattr(delivery, key)) is not None:
                    extra[key] = value
            if not self.graph.registry.has(self.type):
                extra["want_definition"] = True
            if self.graph.one_of_several:
                extra["again"] = True
        elif encoding in ("auto", "zstd"):
            encoding = "cbor-raw"
        self.used = encoding
        depth = queue_depth(delivery, self._qos)
        peer.send(
            ops.Subscribe(
                id=self.id,
                topic=self.topic,
                type=self.graph.spelling.type_name(self.type),
                throttle_rate=round(1000 / delivery.rate_hz) if delivery.rate_hz and extra is None else 0,
                queue_length=depth if depth is not None and extra is None and delivery.rate_hz else 0,
                compression=encoding,
                qos=self.asked.to_json() if self.asked is not None else None,
                ropeway=extra,
            )
        )

    def announce_anew(self, peer: Peer) -> None:
        """Ask for the topic once more: its type has another name there."""
        self.disconnected()
        self.connected(peer)

    def disconnected(self) -> None:
        """Let go of the connection, which is gone."""
        self._peer = None

    def published(self, op: ops.Publish) -> None:
        """Take a message that came as a plain ``publish``."""
        peer = self._peer
        if peer is None or self.closed:
            return
        try:
            payload = self.graph.spelling.read(
                peer,
                self.type,
                lambda codec: wire_codec.decode_publish_msg(
                    op.msg, op.compression, codec, limit_bytes=peer.limit_bytes
                ),
            )
        except (TypesError, MessageTooBig) as error:
            self.unreadable(error)
            return
        self.used = _encoding_of(op, self.used)
        echo = self.graph.table.echoes.get(self.topic)
        if echo is not None and echo.echoes(payload):
            return
        now = time.time_ns()
        self._plain_seq = max(now, self._plain_seq + 1)
        batch = [Sample(payload, self.type, now, self._plain_origin, self._plain_seq)]
        try:
            self._deliver(batch)
        except Exception:  # as in ``arrived``
            self.undelivered(batch)

    def learned(self, note: Mapping[str, Any]) -> None:
        """Learn the definition of the type that the far side sent."""
        text = note.get("definition")
        if isinstance(text, str):
            self.graph.teller.tell(self.type, text)

    def codec(self) -> MessageCodec:
        """See ``Inbound.codec``."""
        if self._codec is None:
            self._codec = self.graph.registry.codec(self.type)
        return self._codec

    def unreadable(self, error: Exception) -> None:
        """See ``Inbound.unreadable``."""
        self.graph.drops[self.topic, Undelivered.DECODE] += 1
        if self._peer is not None:
            self._peer.fault_log.note("message", self.topic, error)

    def undelivered(self, batch: Sequence[Sample]) -> None:
        """See ``Inbound.undelivered``."""
        self._callback_failed(batch)

    def _translate(self, batch: Sequence[Sample]) -> None:
        incoming = self.graph.border.incoming
        self._callback([sample.carrying(incoming(self.type, sample.payload)) for sample in batch])

    async def close(self) -> None:
        """Stop reading."""
        if self.closed:
            return
        self.closed = True
        self.graph.table.forget(self.number, self.topic)
        if self._peer is not None:
            self._peer.forget_inbound(self.number)
            self._peer.send(ops.Unsubscribe(id=self.id, topic=self.topic))
            self._peer = None


def queue_depth(delivery: Delivery, qos: QoS) -> int | None:
    """Return how many messages of a topic may wait on a link: as configured, else by its QoS; ``None`` keeps all."""
    if delivery.depth is not None:
        return delivery.depth
    if qos.history == "keep_all" and qos.reliable:
        return None
    return max(qos.depth, 1)


def _encoding_of(op: ops.Publish, asked: str) -> str:
    """Return the encoding of a message that came; plain servers need not name it, and take unknown ones for none."""
    if op.compression is not None:
        return op.compression
    raw = op.msg.get("bytes") if isinstance(op.msg, dict) else op.msg
    if isinstance(raw, bytes):
        return "cbor-raw"
    return asked if asked in ROSBRIDGE.subscribe - {"cbor-raw"} else "none"
