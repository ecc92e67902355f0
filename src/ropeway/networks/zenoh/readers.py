"""Topics that we read from a network of rmw_zenoh: subscriptions, and the readers that they share."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

import zenoh
import zenoh.ext

from ropeway.errors import TypesError
from ropeway.graph.base import Sample, Undelivered
from ropeway.graph.inlet import Inlet
from ropeway.graph.qos_adoption import AdoptingSubscription, Readers, SharedReader
from ropeway.limits import ZENOH_READ_BYTES
from ropeway.networks.zenoh.attachment import parse
from ropeway.networks.zenoh.discovery import SenderIdentity, ZenohDiscovery
from ropeway.networks.zenoh.hashed_layouts import HashedLayouts
from ropeway.networks.zenoh.publisher import ZenohTopicHost
from ropeway.networks.zenoh.session import ZenohPresence, ZenohSession
from ropeway.qos import QoS

__all__ = ["ZenohReader", "ZenohReaders", "ZenohSubscription"]

_SHORTEST_BYTES = 4  # of CDR: its header


class ZenohReader:
    """A subscriber of Zenoh's for all hashes of a type, and the tokens by which publishers see it."""

    def __init__(
        self,
        session: ZenohSession,
        reader: SharedReader[ZenohReader],
        type_hash: str,
        identities: dict[bytes, SenderIdentity],
        deliver: Callable[[list[tuple[Sample, str]]], None],
        clock: Callable[[], int],
    ) -> None:
        topic, type, qos = reader.topic, reader.type, reader.qos
        self.matched = 0
        self._type = type
        self._session, self._identities, self._clock = session, identities, clock
        self._deliver, self._dropped = deliver, reader.dropped
        self._lost = 0
        self._inlet: Inlet[tuple[Sample, str] | None] = Inlet(
            asyncio.get_running_loop(), self._give, limit_bytes=ZENOH_READ_BYTES
        )
        key, handler = session.key(topic, type, "*"), zenoh.handlers.Callback(self._take, indirect=False)
        declare = _latched if qos.transient_local else _volatile
        self._raw: Any = session.attempt(lambda: declare(session.raw, key, handler, qos))
        self.presence = ZenohPresence(session, "subscription", topic, type, type_hash, qos)

    def close(self) -> None:
        """Stop reading."""
        self._inlet.closed = True
        self.presence.close()
        self._session.undeclare(self._raw)

    def _take(self, sample: zenoh.Sample) -> None:
        """Take a message, in a thread of Zenoh's."""
        raw = sample.attachment
        attachment = None if raw is None else parse(bytes(raw))
        payload = bytes(sample.payload)
        if attachment is None or len(payload) < _SHORTEST_BYTES:
            self._inlet.put(None)
            return
        identity = self._identities.get(attachment.gid)
        if identity is not None and not identity.wanted:
            return
        relayed = identity is not None and identity.relayed
        seq = attachment.stamp_ns or attachment.number
        made = Sample(payload, self._type, self._clock(), attachment.gid, seq, relayed)
        self._inlet.put((made, str(sample.key_expr).rpartition("/")[2]), len(payload))

    def _give(self, batch: list[tuple[Sample, str] | None]) -> None:
        """Hand over what has come, on the loop; ``None`` stands for a malformed message."""
        good = [item for item in batch if item is not None]
        lost, self._lost = self._inlet.lost - self._lost, self._inlet.lost
        counts = ((Undelivered.DECODE, len(batch) - len(good)), (Undelivered.BACKLOG, lost))
        if drops := [(reason, count) for reason, count in counts if count]:
            self._dropped(drops)
        self._deliver(good)


def _volatile(session: zenoh.Session, key: str, handler: Any, qos: QoS) -> Any:
    return session.declare_subscriber(key, handler, allowed_origin=zenoh.Locality.REMOTE)


def _latched(session: zenoh.Session, key: str, handler: Any, qos: QoS) -> Any:
    recovers = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True) if qos.reliable else None
    return zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        handler,
        allowed_origin=zenoh.Locality.REMOTE,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=max(qos.depth, 1)),
        recovery=recovers,
        subscriber_detection=True,
    )


class ZenohReaders(Readers[ZenohReader]):
    """Holds the readers behind the subscriptions of an opened graph."""

    def __init__(self, graph: ZenohTopicHost, clock: Callable[[], int] = time.time_ns) -> None:
        super().__init__(graph)
        self._session: ZenohSession = graph.session
        self._discovery: ZenohDiscovery = graph.discovery
        self._layouts: HashedLayouts = graph.layouts
        self._clock = clock
        self._open: dict[ZenohReader, SharedReader[ZenohReader]] = {}

    def offered(self, topic: str, type: str) -> list[QoS]:
        """See ``Readers``."""
        return [token.qos for token in self._discovery.others("publisher", topic, type)]

    def is_matched(self, reader: SharedReader[ZenohReader]) -> bool:
        """See ``Readers``: a subscriber gets all that is published under its key."""
        return True

    def follow(self, topics: set[str]) -> None:
        """See who publishes these topics, and under which hashes."""
        for raw, reader in self._open.items():
            if reader.topic in topics:
                self._match(raw, reader)
        self.readopt(topics)

    def _match(self, raw: ZenohReader, reader: SharedReader[ZenohReader]) -> None:
        publishers = self._discovery.others("publisher", reader.topic, reader.type)
        raw.matched = len(publishers)
        raw.presence.follow(token.type_hash for token in publishers)

    def _make(self, reader: SharedReader[ZenohReader]) -> ZenohReader:
        made = ZenohReader(
            self._session,
            reader,
            self._layouts.own_hash(reader.type),
            self._discovery.identities,
            lambda batch: self._deliver(reader, batch),
            self._clock,
        )
        self._open[made] = reader
        self._match(made, reader)
        return made

    async def _delete(self, raw: ZenohReader) -> None:
        del self._open[raw]
        raw.close()

    def _deliver(self, reader: SharedReader[ZenohReader], batch: list[tuple[Sample, str]]) -> None:
        """Give a batch to the subscriptions of a reader, in our layout."""
        read, type = self._layouts.read, reader.type
        samples = []
        for sample, type_hash in batch:
            try:
                samples.append(sample.carrying(read(type, sample.payload, type_hash)))
            except TypesError:
                reader.dropped([(Undelivered.DECODE, 1)])
        reader.deliver(samples)


ZenohSubscription = AdoptingSubscription[ZenohReader]
