"""The topics of one client: what it publishes on our graph, and what it reads from it."""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from ropeway.bridge.meter import Meter
from ropeway.bridge.pipeline import Drop, RateLimit
from ropeway.errors import MessageTooBig, TypesError
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.qos import QoS
from ropeway.wire import codec as wire_codec
from ropeway.wire import ops
from ropeway.wire.records import Arrival

if TYPE_CHECKING:
    from ropeway.graph.base import Publisher, Subscription
    from ropeway.link.peer import Channel
    from ropeway.server.session import Session
    from ropeway.types import MessageCodec

__all__ = ["TopicIn", "TopicOut", "topic_status"]

log = logging.getLogger("ropeway.server")

_EARLY_LIMIT_BYTES: Final = 16 << 20  # what may wait while a publisher is being made
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
        self.ids: set[str] = set()
        self.publisher: Publisher | None = None
        self.meter = Meter()
        self.number: int | None = None
        self._codec: MessageCodec | None = None
        self._early: deque[Sample] = deque()
        self._early_bytes = 0
        self._origin = new_origin()

    def ready(self, publisher: Publisher) -> None:
        """The publisher was made: what came early goes out."""
        self.publisher = publisher
        while self._early:
            publisher.publish(self._early.popleft())
        self._early_bytes = 0
        if self.number is not None:
            number = self.number
            publisher.on_demand(
                lambda count: self.session.peer.send({"op": "demand", "channel": number, "count": count})
            )

    def codec(self) -> MessageCodec:
        """How to read the client's messages. Raises ``UnknownType``."""
        if self._codec is None:
            self._codec = self.session.registry.codec(self.type)
        return self._codec

    def published(self, op: ops.Publish) -> None:
        """A message came as a plain ``publish``. Raises ``TypesError``."""
        compression = op.compression or self.compression
        raw = compression in ("cbor-raw", "rawzip")
        peer = self.session.peer
        payload = wire_codec.decode_publish_msg(
            op.msg, compression, None if raw else self.codec(), limit_bytes=peer.limit_bytes
        )
        self._publish(Sample(payload, self.type, self.session.clock(), self._origin, SEQ_NONE))

    def arrived(self, arrivals: Sequence[Arrival]) -> None:
        """Messages came in records."""
        session = self.session
        peer = session.peer
        now = session.clock()
        offset = peer.clock_offset_ns
        for arrival in arrivals:
            payload = arrival.body
            if arrival.encoding != wire_codec.CBOR_RAW:
                needs = wire_codec.encoding_name(arrival.encoding) not in ("rawzip", "zstd")
                try:
                    payload = peer.decode(arrival, self.codec() if needs else None)
                except (TypesError, MessageTooBig) as error:
                    peer.complaints.note("message", self.topic, error)
                    continue
            sent = arrival.stamp_ns - offset if arrival.stamp_ns else 0
            self._publish(Sample(payload, self.type, now, arrival.origin, arrival.seq, arrival.relayed, sent))

    def _publish(self, sample: Sample) -> None:
        self.meter.add(sample, sample.stamp_ns)
        if self.publisher is not None:
            self.publisher.publish(sample)
            return
        self._early.append(sample)
        self._early_bytes += len(sample.payload)
        while self._early_bytes > _EARLY_LIMIT_BYTES and len(self._early) > 1:
            self._early_bytes -= len(self._early.popleft().payload)

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
        self.subscription: Subscription | None = None
        self.channel: Channel | None = None
        self.drops: Counter[Drop] = Counter()
        self.meter = Meter()
        self._limit: RateLimit | None = None
        self._wanted_definition = False
        self._depth: int | None = None

    def settle(self) -> None:
        """Fit the channel to what all requests of the client ask for together."""
        requests = list(self.requests.values())
        extra: dict[str, Any] = {}
        for request in requests:
            extra.update(request.ropeway or {})
        rate = _number(extra.get("rate_hz"))
        if rate is None:
            throttle = min(r.throttle_rate for r in requests)
            rate = 1000.0 / throttle if throttle > 0 else None
        self._limit = RateLimit(rate) if rate else None
        encoding = max((r.compression or "none" for r in requests), key=lambda c: _PRIORITY_OF_COMPRESSION.get(c, 0))
        if encoding not in _PRIORITY_OF_COMPRESSION:
            encoding = "none"
        depth = _number(extra.get("depth"))
        if depth is None:
            lengths = [r.queue_length for r in requests]
            depth = min(lengths) if min(lengths) > 0 else None
        self._depth = None if depth is None else int(depth)
        if self.channel is not None:
            self.channel.close()
        self.channel = self.session.peer.open_channel(
            self.number,
            self.topic,
            self.type,
            encoding=encoding,
            priority=int(_number(extra.get("priority")) or 0) if "priority" in extra else 4,
            depth=self._depth or 10,
            lifespan_s=_number(extra.get("lifespan_s")),
        )
        self._wanted_definition = bool(extra.get("want_definition"))
        if self.subscription is not None:
            self.follow(self.subscription.qos)

    def follow(self, qos: QoS) -> None:
        """The subscription has this profile: queue as deep, and tell a gateway."""
        if self.channel is not None and self._depth is None:
            keep_all = qos.history == "keep_all" and qos.reliable
            self.channel.queue.depth = None if keep_all else max(qos.depth, 1)
        if not self.session.gateway:
            return
        message: dict[str, Any] = {"op": "adopted", "channel": self.number, "qos": qos.to_json()}
        if self._wanted_definition and self.session.registry.has(self.type):
            message["definition"] = self.session.registry.full_text(self.type)
        self.session.peer.send(message)

    def deliver(self, batch: Sequence[Sample]) -> None:
        """Messages came from the graph."""
        channel, limit = self.channel, self._limit
        if channel is None:
            return
        for sample in batch:
            if limit is not None and (reason := limit(sample)) is not None:
                self.drops[reason] += 1
            else:
                self.meter.add(sample, sample.stamp_ns)
                channel.put(sample)

    async def close(self) -> None:
        """Stop reading."""
        if self.channel is not None:
            self.channel.close()
            self.channel = None
        if self.subscription is not None:
            await self.subscription.close()
            self.subscription = None


def topic_status(topic: str, direction: str, type: str, meter: Meter, drops: Mapping[Any, int]) -> dict[str, Any]:
    """One row of a table."""
    return {
        "name": topic,
        "direction": direction,
        "type": type,
        "messages": meter.messages,
        "rate_hz": round(meter.rate_hz, 2),
        "bandwidth_bps": round(meter.rate_bps),
        "delay_ms": None if meter.delay_s is None else round(1e3 * meter.delay_s, 3),
        "drops": {reason.value: n for reason, n in drops.items() if n},
    }


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not value > 0:
        return None
    return float(value)
