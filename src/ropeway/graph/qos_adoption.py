"""Topics that we read from a network of ROS 2: readers that several subscriptions share, and subscriptions that
follow the profiles of the publishers.

The graph makes and deletes the readers of its middleware; this module decides which there are, and sees to it that a
change of profile loses no message and gives none twice.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final, Generic, Protocol, TypeVar

from ropeway.graph.base import SEQ_NONE, Sample, SampleCallback, Undelivered
from ropeway.logs import failed
from ropeway.qos import DEFAULT, QoS
from ropeway.tasks import Chores

__all__ = ["AdoptingSubscription", "Host", "SharedReader", "settled"]

log = logging.getLogger("ropeway.graph")

# How long the reader of the old profile is kept beside the new one: writers elsewhere must find the new reader first.
_OVERLAP_S: Final = 1.0
_OVERLAP_TRIES: Final = 5
_SEEN_LIMIT: Final = 1024
_MISSING: Final = b"missing"

R = TypeVar("R")
T = TypeVar("T")


class Host(Protocol[R]):
    """The services of a graph for its subscriptions."""

    name: str
    drops: Counter[tuple[str, Undelivered]]

    def attach(self, subscription: Any, qos: QoS) -> SharedReader[R]:
        """Return a reader for a subscription. Raises ``GraphUnavailable``."""

    async def detach(self, subscription: Any, reader: SharedReader[R]) -> None:
        """Take a subscription off its reader; the last one takes the reader with it."""

    def forget(self, subscription: Any) -> None:
        """Release what belongs to a closed subscription."""

    def is_matched(self, subscription: Any, reader: SharedReader[R]) -> bool:
        """Return whether a reader is matched with every publisher that it should read."""

    def guard(self, topic: str, callback: Callable[[T], None], value: T) -> None:
        """Run a callback that may fail."""


class SharedReader(Generic[R]):
    """A reader and the subscriptions it serves: one for all volatile subscriptions of a topic, type and profile.

    ``raw`` is what the middleware knows it by.
    """

    def __init__(self, graph: Host[R], topic: str, qos: QoS) -> None:
        self.topic, self.qos = topic, qos
        self.raw: R | None = None
        self.subscriptions: tuple[AdoptingSubscription[R], ...] = ()
        self._graph = graph

    def deliver(self, batch: list[Sample]) -> None:
        """Give a batch to every subscription."""
        for subscription in self.subscriptions:
            subscription.deliver(batch)

    def dropped(self, counts: list[tuple[Undelivered, int]]) -> None:
        """Count what the thread let go."""
        for reason, count in counts:
            self._graph.drops[self.topic, reason] += count


def settled(asked: QoS, offered: QoS) -> QoS:
    """Return ``asked`` with every ``best_available`` policy replaced by that of ``offered``."""
    return replace(
        asked,
        reliability=offered.reliability if asked.reliability == "best_available" else asked.reliability,
        durability=offered.durability if asked.durability == "best_available" else asked.durability,
    )


class AdoptingSubscription(Generic[R]):
    """A topic that we read; without a profile of its own it adopts what all publishers offer, and follows their
    changes. Without a profile of its own it adopts what all publishers offer, and follows them.

    A profile with ``best_available`` policies adopts these alone.
    """

    def __init__(self, graph: Host[R], topic: str, type: str, qos: QoS | None, callback: SampleCallback) -> None:
        self.topic, self.type = topic, type
        self.asked = qos
        self.adopts = qos is None or "best_available" in (qos.reliability, qos.durability)
        self.closed = False
        self._graph = graph
        self._qos = DEFAULT if qos is None else settled(qos, DEFAULT)
        self._callback = callback
        self._readers: list[SharedReader[R]] = []  # the last is the one in use, the others overlap with it
        self._seen: dict[int, bytes | None] = {}  # as in ``ropeway.graph.deduplication``
        self._overlap: asyncio.TimerHandle | None = None
        self._tries = 0
        self._closing = Chores()
        self._qos_callbacks: list[Callable[[QoS], None]] = []

    @property
    def qos(self) -> QoS:
        """The profile in use."""
        return self._qos

    def on_qos(self, callback: Callable[[QoS], None]) -> None:
        """Call with the profile, now and when the adopted one changes."""
        self._qos_callbacks.append(callback)
        callback(self._qos)

    def follow(self, qos: QoS) -> None:
        """Read with ``qos``: a reader with it is made before the one there is goes."""
        if self.closed or (self._readers and qos == self._qos):
            return
        self._qos = qos
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
        for callback in self._qos_callbacks:
            self._graph.guard(self.topic, callback, qos)

    def deliver(self, batch: list[Sample]) -> None:
        """Give a batch to the callback, on the loop."""
        if self.closed:
            return
        fresh = self._fresh(batch) if self.adopts else batch
        if not fresh:
            return
        try:
            self._callback(fresh)
        except Exception:  # a callback is somebody else's code; the others must not suffer
            self._graph.drops[self.topic, Undelivered.CALLBACK] += len(fresh)
            failed(log, "%s: a callback for %s failed", self._graph.name, self.topic)

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

    def _fresh(self, batch: list[Sample]) -> list[Sample]:
        """Return ``batch`` without samples that another reader of ours has delivered, or delivers at the same time."""
        seen = self._seen
        fresh = []
        for sample in batch:
            if sample.seq != SEQ_NONE:
                known = seen.get(sample.seq, _MISSING)
                if known is not _MISSING and (known is None or sample.relayed or known == sample.origin):
                    continue
                seen[sample.seq] = None if sample.relayed else sample.origin
            fresh.append(sample)
        excess = len(seen) - max(_SEEN_LIMIT, 2 * self._qos.depth)
        if excess > 0:
            for key in [k for k, _ in zip(seen, range(excess), strict=False)]:
                del seen[key]
        return fresh

    def _arm(self) -> None:
        if self._overlap is not None:
            self._overlap.cancel()
        self._overlap = asyncio.get_running_loop().call_later(_OVERLAP_S, self._end_overlap)

    def _end_overlap(self) -> None:
        self._overlap = None
        self._tries += 1
        if self._tries < _OVERLAP_TRIES and not self._graph.is_matched(self, self._readers[-1]):
            self._arm()
            return
        old, self._readers = self._readers[:-1], self._readers[-1:]
        for reader in old:
            self._closing.start(self._graph.detach(self, reader), f"end of a reader of {self.topic}")
