"""The topics of one client: what it publishes on our graph, and what it reads from it."""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from ropeway.delivery.meter import Meter
from ropeway.delivery.outbox import Lost
from ropeway.delivery.pipeline import Drop, RateLimit
from ropeway.delivery.throttle import Throttle
from ropeway.errors import MessageTooBig, TypesError
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.limits import LONGEST_THROTTLE_MS, QOS_DEPTH_SAMPLES, REMEMBERED_PUBLISH_IDS
from ropeway.networks.rosbridge.protocol import codec as wire_codec
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.dialect import ROSGW
from ropeway.networks.rosbridge.protocol.records import Arrival
from ropeway.qos import QoS

if TYPE_CHECKING:
    from ropeway.graph.base import Subscription
    from ropeway.hub.topics import ViewPublisher
    from ropeway.networks.rosbridge.link.peer import Channel
    from ropeway.networks.rosbridge.server.session import Session
    from ropeway.types import MessageCodec

__all__ = ["REGISTRATION_BYTES", "TopicIn", "TopicOut", "topic_status"]

log = logging.getLogger("ropeway.server")

REGISTRATION_BYTES: Final = 2 << 10  # of one id of one topic: the operation, its names, and the place in tables
_EARLY_LIMIT_BYTES: Final = 16 << 20  # what may wait while a publisher is being made
_LEAST_WEIGHT: Final = 0.1  # as in the configuration
_MOST_WEIGHT: Final = 100.0
_PRIORITY_OF_COMPRESSION: Final = {
    "none": 0,
    "png": 1,
    "cbor": 2,
    "zip": 3,
    "rawzip": 4,
    "zstd": 5,
    "cbor-raw": 6,
    "auto": 7,
}


class TopicIn:
    """A topic that the client publishes. ``ids`` are its registrations; the last one to go withdraws the topic."""

    def __init__(self, session: Session, topic: str, type: str, compression: str | None) -> None:
        self.session, self.topic, self.type, self.compression = session, topic, type, compression
        self.name = ""  # on the graph, once it is published there
        self.ids: set[str] = set()
        self.unique = False  # the client asked that a message whose id came before be dropped
        self._ids_seen: dict[int, None] = {}
        self.publisher: ViewPublisher | None = None
        self.meter = Meter()
        self.number: int | None = None
        self.encoding = compression or "none"  # of the last message
        self._codec: MessageCodec | None = None
        self.lost: Counter[Lost] = Counter()
        self._early: deque[Sample] | None = None  # what waits until there is a publisher
        self._early_bytes = 0
        self._origin = new_origin()

    def ready(self, publisher: ViewPublisher) -> None:
        """Take the publisher that was made, and publish what came early."""
        self.publisher = publisher
        early, self._early, self._early_bytes = self._early, None, 0
        for sample in early or ():
            publisher.publish(sample)
        if self.number is not None:
            number = self.number
            publisher.on_demand(
                lambda count: self.session.peer.send({"op": "demand", "channel": number, "count": count})
            )

    @property
    def held_bytes(self) -> int:
        """The bytes kept for the client."""
        kept = self.publisher.kept_bytes if self.publisher is not None else 0
        return self._early_bytes + kept + REGISTRATION_BYTES * len(self.ids)

    def codec(self) -> MessageCodec:
        """Return the codec for the client's messages. Raises ``UnknownType``."""
        if self._codec is None:
            self._codec = self.session.codec(self.type)
        return self._codec

    def published(self, op: ops.Publish) -> None:
        """Publish a message that came as a plain ``publish``. Raises ``TypesError``."""
        if ops.present(op.id) and self._unique(op) and not self._is_new(op.id):
            self.lost[Lost.REPEATED] += 1
            return
        compression = op.compression or self.compression
        raw = compression in ("cbor-raw", "rawzip")
        peer = self.session.peer
        codec = self.codec() if not raw or self.session.knows(self.type) else None
        payload = wire_codec.decode_publish_msg(op.msg, compression, codec, limit_bytes=peer.limit_bytes)
        self._publish(Sample(payload, self.type, self.session.clock(), self._origin, SEQ_NONE))

    def _unique(self, op: ops.Publish) -> bool:
        """Return whether the id of a message says which one it is: gateways of the older kind mean that, others ask."""
        return self.unique or self.session.peer.dialect is ROSGW or (op.ropeway or {}).get("unique_ids") is True

    def _is_new(self, id: object) -> bool:
        key = hash(repr(id))
        if key in self._ids_seen:
            return False
        self._ids_seen[key] = None
        if len(self._ids_seen) > REMEMBERED_PUBLISH_IDS:
            del self._ids_seen[next(iter(self._ids_seen))]
        return True

    def arrived(self, arrivals: Sequence[Arrival]) -> None:
        """Publish messages that came in records."""
        session = self.session
        peer = session.peer
        now = session.clock()
        offset = peer.clock_offset_ns
        for arrival in arrivals:
            payload = arrival.body
            if arrival.encoding != wire_codec.CBOR_RAW:
                try:
                    needs = wire_codec.encoding_name(arrival.encoding) not in ("rawzip", "zstd")
                    payload = peer.decode(arrival, self.codec() if needs else None)
                except (TypesError, MessageTooBig) as error:
                    peer.fault_log.note("message", self.topic, error)
                    continue
            self.encoding = wire_codec.ENCODINGS[arrival.encoding]
            sent = arrival.stamp_ns - offset if arrival.stamp_ns and offset is not None else 0
            self._publish(Sample(payload, self.type, now, arrival.origin, arrival.seq, arrival.relayed, sent))

    def _publish(self, sample: Sample) -> None:
        self.meter.add(sample, sample.stamp_ns)
        if self.publisher is not None:
            self.publisher.publish(sample)
            return
        early = self._early
        if early is None:
            early = self._early = deque()
        early.append(sample)
        self._early_bytes += len(sample.payload)
        while self._early_bytes > _EARLY_LIMIT_BYTES and len(early) > 1:
            self._early_bytes -= len(early.popleft().payload)
            self.lost[Lost.OVERFLOW] += 1

    def report(self) -> None:
        """Tell a gateway how its topic arrives."""
        self.meter.update()
        if self.number is not None and self.meter.messages:
            delay = self.meter.delay_s
            stats: dict[str, Any] = {"op": "stats", "channel": self.number, "rate_hz": round(self.meter.rate_hz, 2)}
            if delay is not None:
                stats["delay_ms"] = round(1e3 * delay, 3)
            self.session.peer.send(stats)

    async def close(self) -> None:
        """Withdraw the topic."""
        if self.publisher is not None:
            await self.publisher.close()
            self.publisher = None


class TopicOut:
    """A topic that the client reads: one subscription on the graph, one channel, however many ids ask for it."""

    def __init__(self, session: Session, topic: str, type: str, number: int) -> None:
        self.session, self.topic, self.type, self.number = session, topic, type, number
        self.requests: dict[str, ops.Subscribe] = {}
        self.qos: QoS | None = None  # as the client asked for
        self.subscription: Subscription | None = None
        self.channel: Channel | None = None
        self.drops: Counter[Drop] = Counter()
        self.meter = Meter()
        self._limit: RateLimit | None = None
        self._throttle: Throttle | None = None
        self._wanted_definition = False
        self._depth: int | None = None

    @property
    def held_bytes(self) -> int:
        """The bytes kept for the client, besides what waits for the link."""
        throttled = self._throttle.bytes if self._throttle is not None else 0
        return throttled + REGISTRATION_BYTES * len(self.requests)

    def settle(self) -> None:
        """Fit the channel to what all requests of the client ask for together."""
        requests = list(self.requests.values())
        extra: dict[str, Any] = {}
        for request in requests:
            extra.update(request.ropeway or {})
        encoding = max((r.compression or "none" for r in requests), key=lambda c: _PRIORITY_OF_COMPRESSION.get(c, 0))
        if encoding not in _PRIORITY_OF_COMPRESSION:
            encoding = "none"
        depth = _number(extra.get("depth"))
        if depth is None:
            lengths = [r.queue_length for r in requests]
            depth = min(lengths) if min(lengths) > 0 else None
        self._depth = None if depth is None else min(int(depth), QOS_DEPTH_SAMPLES)
        channel = self.session.peer.open_channel(
            self.number,
            self.topic,
            self.type,
            encoding=encoding,
            priority=int(_number(extra.get("priority")) or 0) if "priority" in extra else 4,
            depth=self._depth or 10,
            lifespan_s=_number(extra.get("lifespan_s")),
        )
        channel.queue.weight = min(max(_number(extra.get("weight")) or 1.0, _LEAST_WEIGHT), _MOST_WEIGHT)
        if channel.codec is not None or self.session.is_ros1:
            channel.codec = self.session.codec(self.type)
        if self.channel is not None:
            self.channel.close()
        self.channel = channel
        sizes = [r.fragment_size for r in requests if r.fragment_size is not None]
        channel.fragment_size = min(sizes, default=None)
        self._settle_rate(requests, _number(extra.get("rate_hz")))
        self._wanted_definition = bool(extra.get("want_definition"))
        if self.subscription is not None:
            self.follow(self.subscription.qos)

    def _settle_rate(self, requests: Sequence[ops.Subscribe], rate_hz: float | None) -> None:
        """Set the limit: a gateway's rate is kept on average; rosbridge's least time between messages may
        have a queue.
        """
        waiting = self._throttle.close() if self._throttle is not None else []
        self._limit = self._throttle = None
        period_ms = min(LONGEST_THROTTLE_MS, *(r.throttle_rate for r in requests))
        length = min(r.queue_length for r in requests)
        if rate_hz is not None:
            self._limit = RateLimit(rate_hz)
        elif period_ms > 0 and length > 0:
            self._throttle = Throttle(period_ms / 1000, length, self._put, self._dropped)
        elif period_ms > 0:
            self._limit = RateLimit(1000 / period_ms)
        for sample in waiting:
            self._pass(sample)

    def follow(self, qos: QoS) -> None:
        """Adopt the profile of the subscription: queue as deep, and tell a gateway."""
        if self.channel is not None and self._depth is None:
            keep_all = qos.history == "keep_all" and qos.reliable
            self.channel.queue.depth = None if keep_all else max(qos.depth, 1)
            self.channel.queue.latched = qos.latched
        if not self.session.gateway:
            return
        message: dict[str, Any] = {"op": "adopted", "channel": self.number, "qos": qos.to_json()}
        if self._wanted_definition and self.session.registry.has(self.type):
            message["definition"] = self.session.registry.full_text(self.type)
        self.session.peer.send(message)

    def deliver(self, batch: Sequence[Sample]) -> None:
        """Send messages of the graph to the client."""
        channel = self.channel
        if self._throttle is None and self._limit is None and channel is not None:
            for sample in batch:
                self.meter.add(sample, sample.stamp_ns)
                channel.put(sample)
        else:
            for sample in batch:
                self._pass(sample)

    def _pass(self, sample: Sample) -> None:
        if self._throttle is not None:
            self._throttle.put(sample)
        elif self._limit is not None and (reason := self._limit(sample)) is not None:
            self.drops[reason] += 1
        else:
            self._put(sample)

    def _put(self, sample: Sample) -> None:
        if self.channel is not None:
            self.meter.add(sample, sample.stamp_ns)
            self.channel.put(sample)

    def _dropped(self) -> None:
        self.drops[Drop.RATE] += 1

    async def close(self) -> None:
        """Stop reading."""
        if self._throttle is not None:
            self._throttle.close()
            self._throttle = None
        if self.channel is not None:
            self.channel.close()
            self.channel = None
        if self.subscription is not None:
            await self.subscription.close()
            self.subscription = None


def topic_status(
    topic: str, direction: str, type: str, encoding: str, meter: Meter, drops: Mapping[Any, int]
) -> dict[str, Any]:
    """Return one row of the table of topics."""
    return {
        "name": topic,
        "direction": direction,
        "type": type,
        "encoding": encoding,
        "messages": meter.messages,
        "rate_hz": round(meter.rate_hz, 2),
        "bandwidth_bps": round(meter.rate_bps),
        "delay_ms": None if meter.delay_s is None else round(1e3 * meter.delay_s, 3),
        "drops": {reason.value: n for reason, n in drops.items() if n},
    }


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not value > 0:
        return None
    return float(min(value, 1e12))
