"""Topics that we read from a network of ROS 2: readers that several subscriptions share, and subscriptions that
follow the profiles of the publishers.

The graph makes and deletes the readers of its middleware; this module decides which there are, and sees to it that a
change of profile loses no message and gives none twice.
"""

from __future__ import annotations

import asyncio
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Sequence
from dataclasses import replace
from typing import Final, Generic, TypeVar

from ropeway.errors import GraphUnavailable
from ropeway.graph.base import SEQ_NONE, Sample, SampleCallback, Undelivered
from ropeway.graph.deduplication import Seen
from ropeway.graph.host import Host
from ropeway.graph.parts import SubscriptionBase
from ropeway.qos import DEFAULT, QoS, adopted, settled
from ropeway.tasks import Chores

__all__ = ["AdoptingSubscription", "Readers", "SharedReader"]

log = logging.getLogger("ropeway.graph")

# How long the reader of the old profile is kept beside the new one: writers elsewhere must find the new reader first.
_OVERLAP_S: Final = 1.0
_OVERLAP_TRIES: Final = 5
_SEEN_LIMIT: Final = 1024
# Some middlewares do not tell the depth of a publisher; what is adopted keeps at least this many.
_MIN_ADOPTED_DEPTH: Final = 10

R = TypeVar("R")


def _nobody(part: object) -> None:
    """Tell nobody of a part that was closed."""


class Readers(ABC, Generic[R]):
    """The readers of a graph. Volatile subscriptions of one topic, type and profile share one; others have their own.

    A network makes them in ``_make`` and deletes them in ``_delete``, and knows what is offered and matched.
    """

    def __init__(self, graph: Host) -> None:
        self.name, self.drops, self.guard = graph.name, graph.drops, graph.guard
        self._shared: dict[tuple[str, str, QoS], SharedReader[R]] = {}
        self._subscriptions: dict[AdoptingSubscription[R], None] = {}
        self.on_closed: Callable[[AdoptingSubscription[R]], None] = _nobody  # told of each that was closed

    def begin(self, subscription: AdoptingSubscription[R]) -> None:
        """Attach a subscription to a reader with the profile that it should have. Raises ``GraphUnavailable``."""
        subscription.follow(self.adopted(subscription))
        self._subscriptions[subscription] = None

    def forget(self, subscription: AdoptingSubscription[R]) -> None:
        """Forget a subscription that was closed."""
        self._subscriptions.pop(subscription, None)
        self.on_closed(subscription)

    def readopt(self, topics: Container[str]) -> None:
        """Make the subscriptions of these topics adopt what is offered now."""
        for subscription in list(self._subscriptions):
            if subscription.adopts and subscription.topic in topics:
                try:
                    subscription.follow(self.adopted(subscription))
                except GraphUnavailable as error:
                    log.warning("%s: %s keeps its profile: %s", self.name, subscription.topic, error)

    def attach(self, subscription: AdoptingSubscription[R], qos: QoS) -> SharedReader[R]:
        """Return a reader for a subscription. Raises ``GraphUnavailable``."""
        key = (subscription.topic, subscription.type, qos)
        reader = None if qos.transient_local else self._shared.get(key)
        if reader is None:
            reader = SharedReader(self, *key)
            reader.raw = self._make(reader)
            if not qos.transient_local:
                self._shared[key] = reader
        reader.subscriptions = (*reader.subscriptions, subscription)
        return reader

    async def detach(self, subscription: AdoptingSubscription[R], reader: SharedReader[R]) -> None:
        """Take a subscription off its reader; the last one takes the reader with it."""
        reader.subscriptions = tuple(s for s in reader.subscriptions if s is not subscription)
        if reader.subscriptions:
            return
        key = (reader.topic, reader.type, reader.qos)
        if self._shared.get(key) is reader:
            del self._shared[key]
        raw, reader.raw = reader.raw, None
        if raw is not None:
            await self._delete(raw)

    def adopted(self, subscription: AdoptingSubscription[R]) -> QoS:
        """Return the profile that a subscription should have now."""
        asked = subscription.asked
        qos = adopted(asked, self.offered(subscription.topic, subscription.type), subscription.qos)
        if asked is not None:
            return qos
        if qos.history == "keep_last" and not qos.transient_local:
            qos = replace(qos, depth=max(qos.depth, _MIN_ADOPTED_DEPTH))
        return qos

    @abstractmethod
    def offered(self, topic: str, type: str) -> list[QoS]:
        """Return the profiles of those who publish a topic."""

    @abstractmethod
    def is_matched(self, reader: SharedReader[R]) -> bool:
        """Return whether a reader is matched with every publisher that it should read."""

    @abstractmethod
    def _make(self, reader: SharedReader[R]) -> R: ...

    @abstractmethod
    async def _delete(self, raw: R) -> None: ...


class SharedReader(Generic[R]):
    """A reader and the subscriptions it serves. ``raw`` is what the middleware knows it by."""

    def __init__(self, host: Host, topic: str, type: str, qos: QoS) -> None:
        self.topic, self.type, self.qos = topic, type, qos
        self.raw: R | None = None
        self.subscriptions: tuple[AdoptingSubscription[R], ...] = ()
        self._host = host

    def deliver(self, batch: list[Sample]) -> None:
        """Give a batch to every subscription."""
        for subscription in self.subscriptions:
            subscription.deliver(batch)

    def dropped(self, counts: list[tuple[Undelivered, int]]) -> None:
        """Count what the thread let go."""
        for reason, count in counts:
            self._host.drops[self.topic, reason] += count


class AdoptingSubscription(SubscriptionBase[Readers[R]], Generic[R]):
    """A topic that we read; without a profile of its own it adopts what all publishers offer, and follows their
    changes. Without a profile of its own it adopts what all publishers offer, and follows them.

    A profile with ``best_available`` policies adopts these alone.
    """

    def __init__(self, graph: Readers[R], topic: str, type: str, qos: QoS | None, callback: SampleCallback) -> None:
        super().__init__(graph, topic, type, qos, callback)
        self.adopts = qos is None or qos.adopts
        self._qos = DEFAULT if qos is None else settled(qos, DEFAULT)
        self._readers: list[SharedReader[R]] = []  # the last is the one in use, the others overlap with it
        self._seen = Seen()
        self._seen_limit = _SEEN_LIMIT
        self._overlap: asyncio.TimerHandle | None = None
        self._tries = 0
        self._closing = Chores()

    def follow(self, qos: QoS) -> None:
        """Read with ``qos``: a reader with it is made before the one there is goes."""
        if self.closed or (self._readers and qos == self._qos):
            return
        self._qos = qos
        self._seen_limit = max(_SEEN_LIMIT, 2 * qos.depth)
        known = next((reader for reader in self._readers if reader.qos == qos), None)
        if known is not None:  # the profile changed back before the overlap was over
            self._readers.remove(known)
            self._readers.append(known)
        else:
            self._readers.append(self._graph.attach(self, qos))
        if len(self._readers) == 1:
            return
        self._tries = 0
        self._arm()
        self._tell_qos()

    def deliver(self, batch: Sequence[Sample]) -> None:
        """Hand messages to the callback, those that come by two readers once."""
        if self.closed:
            return
        fresh = batch
        if self.adopts:  # what another reader of ours has delivered, or delivers at the same time, is left out
            seen, fresh = self._seen, []
            for sample in batch:
                seq = sample.seq
                if seq != SEQ_NONE:
                    if seq in seen and seen.has(sample):
                        continue
                    seen[seq] = None if sample.relayed else sample.origin
                fresh.append(sample)
            if len(seen) > 2 * self._seen_limit:
                seen.trim(self._seen_limit)
            if not fresh:
                return
        try:
            self._callback(fresh)
        except Exception:  # as in ``SubscriptionBase``
            self._callback_failed(fresh)

    async def close(self) -> None:
        """Stop reading."""
        if not self.closed:
            self.closed = True
            self._qos_callbacks.clear()
            self._seen.clear()
            if self._overlap is not None:
                self._overlap.cancel()
            self._graph.forget(self)
        readers, self._readers = self._readers, []
        for reader in readers:
            await self._graph.detach(self, reader)
        await self._closing.wait()

    def _arm(self) -> None:
        if self._overlap is not None:
            self._overlap.cancel()
        self._overlap = asyncio.get_running_loop().call_later(_OVERLAP_S, self._end_overlap)

    def _end_overlap(self) -> None:
        self._overlap = None
        self._tries += 1
        if self._tries < _OVERLAP_TRIES and not self._graph.is_matched(self._readers[-1]):
            self._arm()
            return
        old, self._readers = self._readers[:-1], self._readers[-1:]
        for reader in old:
            self._closing.start(self._graph.detach(self, reader), f"end of a reader of {self.topic}")
