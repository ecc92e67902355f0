"""The topics of one client: what it publishes on our graph, and what it reads from it."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from ropeway.delivery.early_queue import EarlyQueue
from ropeway.delivery.outbox import Lost
from ropeway.delivery.passage import Passage
from ropeway.delivery.pipeline import Drop, RateLimit, Step, witnessed
from ropeway.delivery.throttle import Throttle
from ropeway.graph.base import SEQ_NONE, Sample, Undelivered, new_origin
from ropeway.limits import LONGEST_THROTTLE_MS, QOS_DEPTH_SAMPLES, REMEMBERED_PUBLISH_IDS
from ropeway.logs import failed
from ropeway.networks.rosbridge.link.inbound import Inbound
from ropeway.networks.rosbridge.protocol import codec as wire_codec
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.dialect import ROSGW
from ropeway.qos import QoS

if TYPE_CHECKING:
    from ropeway.graph.base import Subscription
    from ropeway.hub.topics import ViewPublisher
    from ropeway.networks.rosbridge.link.peer import Channel
    from ropeway.networks.rosbridge.server.host import SessionHost
    from ropeway.types import MessageCodec

__all__ = ["REGISTRATION_BYTES", "TopicIn", "TopicOut", "topic_status"]

log = logging.getLogger("ropeway.server")

REGISTRATION_BYTES: Final = 2 << 10  # of one id of one topic: the operation, its names, and the place in tables
_JUST_NS: Final = 1_000_000_000  # a link that may be cut is doubted well before, and another asked
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


class TopicIn(Inbound):
    """A topic that the client publishes. ``ids`` are its registrations; the last one to go withdraws the topic.

    It is a passage from the link to the publisher, and no bridge: a bridge makes its publisher when it can, again and
    again, while here the client's operation makes it, and is answered if that fails.
    """

    def __init__(self, session: SessionHost, topic: str, type: str, compression: str | None) -> None:
        self.passage = Passage(delays=session.view.hub.client_delays.published(topic))
        super().__init__(type, session.peer, self.passage.pass_on, used=compression or "none")
        self.session, self.topic, self.compression = session, topic, compression
        self.name = ""  # on the graph, once it is published there
        self.ids: set[str] = set()
        self.unique = False  # the client asked that a message whose id came before be dropped
        self._ids_seen: dict[int, None] = {}
        self.publisher: ViewPublisher | None = None
        self.number: int | None = None
        self._codec: MessageCodec | None = None
        self._early = EarlyQueue(self.passage.drops)
        self.passage.steps = (self._early.hold,)
        self._origin = new_origin()

    def ready(self, publisher: ViewPublisher) -> None:
        """Take the publisher that was made, and publish what came early."""
        peer, number = self.session.peer, self.number
        self.publisher = publisher
        self.passage.steps = witnessed(self.session.access.witness("publish", publisher.topic))
        self.passage.sink = publisher.publish
        self.passage.pass_on(self._early.take())
        if number is not None:
            if not self.session.access.limited:  # what is counted for a role goes by way of the session
                peer.receivers[number] = self.arrived
            publisher.on_demand(lambda count: peer.send({"op": "demand", "channel": number, "count": count}))

    @property
    def held_bytes(self) -> int:
        """The bytes kept for the client."""
        kept = self.publisher.kept_bytes if self.publisher is not None else 0
        return self._early.bytes + kept + REGISTRATION_BYTES * len(self.ids)

    def codec(self) -> MessageCodec:
        """Return the codec for the client's messages. Raises ``UnknownType``."""
        if self._codec is None:
            self._codec = self.session.codec(self.type)
        return self._codec

    def unreadable(self, error: Exception) -> None:
        """See ``Inbound.unreadable``."""
        self.session.peer.fault_log.note("message", self.topic, error)

    def undelivered(self, batch: Sequence[Sample]) -> None:
        """See ``Inbound.undelivered``."""
        view = self.session.view
        view.drops[self.name, Undelivered.CALLBACK] += len(batch)
        failed(log, "%s: publishing %s failed", view.name, self.topic)

    def published(self, op: ops.Publish) -> None:
        """Publish a message that came as a plain ``publish``. Raises ``TypesError``."""
        if ops.present(op.id) and self._unique(op) and not self._is_new(op.id):
            self.passage.drops[Lost.REPEATED] += 1
            return
        compression = op.compression or self.compression
        raw = compression in ("cbor-raw", "rawzip")
        peer = self.session.peer
        codec = self.codec() if not raw or self.session.knows(self.type) else None
        payload = wire_codec.decode_publish_msg(op.msg, compression, codec, limit_bytes=peer.limit_bytes)
        self.passage.pass_on((Sample(payload, self.type, time.time_ns(), self._origin, SEQ_NONE),))

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

    def report(self) -> None:
        """Tell a gateway how its topic arrives, and what of it is dropped here."""
        meter, drops = self.passage.meter, _counts(self.passage.drops)
        meter.update()
        if self.number is not None and (meter.messages or drops):
            delay = meter.delay_s
            stats: dict[str, Any] = {"op": "stats", "channel": self.number, "rate_hz": round(meter.rate_hz, 2)}
            if delay is not None:
                stats["delay_ms"] = round(1e3 * delay, 3)
            self.session.peer.send({**stats, "messages": meter.messages, "drops": drops})

    async def close(self) -> None:
        """Withdraw the topic."""
        if self.publisher is not None:
            await self.publisher.close()
            self.publisher = self.passage.sink = None


class TopicOut:
    """A topic that the client reads: one subscription on the graph, one channel, however many ids ask for it.

    It is a passage from the subscription to the channel, and no bridge: who asks decides what is read, and hears at
    once if it cannot be.
    """

    def __init__(self, session: SessionHost, topic: str, type: str, number: int) -> None:
        self.session, self.topic, self.type, self.number = session, topic, type, number
        self.requests: dict[str, ops.Subscribe] = {}
        self.qos: QoS | None = None  # as the client asked for
        self.subscription: Subscription | None = None
        self.channel: Channel | None = None
        self.passage = Passage(delays=session.view.hub.client_delays.read(topic))
        self._throttle: Throttle | None = None
        self._wanted_definition = False
        self._depth: int | None = None
        self._reported: dict[str, int] = {}

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
        channel.asked = self.channel is None and not extra.get("want_definition")  # that comes before its messages
        channel.queue.weight = min(max(_number(extra.get("weight")) or 1.0, _LEAST_WEIGHT), _MOST_WEIGHT)
        if channel.codec is not None or self.session.is_ros1:
            channel.codec = self.session.codec(self.type)
        if self.channel is not None:
            self.channel.close()
        self.channel = channel
        self.passage.sink = channel.put
        sizes = [r.fragment_size for r in requests if r.fragment_size is not None]
        channel.fragment_size = min(sizes, default=None)
        self._settle_rate(requests, _number(extra.get("rate_hz")))
        self._wanted_definition = bool(extra.get("want_definition"))
        if self.subscription is not None:
            self.follow(self.subscription.qos)

    def just_sent(self) -> list[Sample]:
        """Return the last small messages that the client got, or that are on their way to it."""
        channel, since_ns = self.channel, time.time_ns() - _JUST_NS
        recent = channel.sender.recent if channel is not None else None
        return [sample for stream, sample in recent or () if stream is channel and sample.stamp_ns >= since_ns]

    def send_again(self, samples: Sequence[Sample]) -> None:
        """Send what went by another link of the client, which may have lost it; the client knows what comes twice."""
        if self.channel is not None:
            for sample in samples:
                self.channel.put(sample)

    def _settle_rate(self, requests: Sequence[ops.Subscribe], rate_hz: float | None) -> None:
        """Set the limit: a gateway's rate is kept on average; rosbridge's least time between messages may
        have a queue.
        """
        waiting = self._throttle.close() if self._throttle is not None else []
        self._throttle = None
        period_ms = min(LONGEST_THROTTLE_MS, *(r.throttle_rate for r in requests))
        length = min(r.queue_length for r in requests)
        steps: list[Step] = []
        if rate_hz is not None:
            steps.append(RateLimit(rate_hz))
        elif period_ms > 0 and length > 0:
            self._throttle = Throttle(period_ms / 1000, length, self._release, self._displaced)
            steps.append(self._throttle.put)
        elif period_ms > 0:
            steps.append(RateLimit(1000 / period_ms))
        self.passage.steps = steps
        self.passage.pass_on(waiting)

    def report(self) -> None:
        """Bring the meter up to date, and tell a gateway what of the topic is dropped here."""
        meter, drops = self.passage.meter, _counts(self.passage.drops)
        meter.update()
        if self.channel is not None:
            drops |= _counts(self.channel.queue.lost)
        if self.session.gateway and drops and drops != self._reported:
            self._reported = drops
            stats = {"op": "stats", "channel": self.number, "messages": meter.messages, "drops": drops}
            self.session.peer.send(stats)

    def _release(self, sample: Sample) -> None:
        self.passage.pass_on((sample,), held=True)

    def _displaced(self) -> None:
        self.passage.drops[Drop.RATE] += 1

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

    async def close(self) -> None:
        """Stop reading."""
        if self._throttle is not None:
            self._throttle.close()
            self._throttle = None
        if self.channel is not None:
            self.channel.close()
            self.channel = self.passage.sink = None
        if self.subscription is not None:
            await self.subscription.close()
            self.subscription = None


def topic_status(
    topic: str, direction: str, type: str, encoding: str, passage: Passage, lost: Mapping[Lost, int] | None = None
) -> dict[str, Any]:
    """Return one row of the table of topics."""
    return {"name": topic, "direction": direction, "type": type, "encoding": encoding, **passage.status(lost or {})}


def _counts(counts: Mapping[Any, int]) -> dict[str, int]:
    """Return counts by what their reasons say, as far as there are any."""
    return {reason.value: count for reason, count in counts.items() if count}


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not value > 0:
        return None
    return float(min(value, 1e12))
