"""Implements what the parts of all graphs share; a network adds how its own publish, read and call.

The protocols in ``ropeway.graph.base`` and ``ropeway.graph.calls`` are the contract. These classes are for those who
implement it.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Generic, TypeVar

from ropeway.errors import GraphUnavailable
from ropeway.graph.base import Sample, SampleCallback, Undelivered
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Request
from ropeway.graph.host import Host
from ropeway.graph.local_calls import InFlight
from ropeway.graph.signal import Signal
from ropeway.logs import failed
from ropeway.qos import DEFAULT, QoS, adopted

__all__ = ["ClientBase", "PublisherBase", "SubscriptionBase", "numbered"]

log = logging.getLogger("ropeway.graph")

H = TypeVar("H", bound=Host)


def numbered(sample: Sample, type: str, origin: bytes, last: int) -> Sample:
    """Return a sample without a number (``SEQ_NONE``) as one that ``origin`` publishes first, after number ``last``."""
    seq = max(time.time_ns(), last + 1)
    return Sample(sample.payload, type, sample.stamp_ns or seq, origin, seq, sent_ns=sample.sent_ns)


class PublisherBase(Generic[H]):
    """The base of publishers: counts readers, and reports changes of demand.

    A network calls ``set_subscribers`` when it learns the number, ``None`` where it cannot tell.
    """

    def __init__(self, graph: H, topic: str, type: str, qos: QoS) -> None:
        self.topic, self.type, self.qos = topic, type, qos
        self.closed = False
        self._graph = graph
        self._subscribers: int | None = 0
        self._demand: list[Callable[[int], None]] = []
        self._seq = 0

    @property
    def subscribers(self) -> int | None:
        """See ``Publisher.subscribers``."""
        return self._subscribers

    def on_demand(self, callback: Callable[[int], None]) -> None:
        """See ``Publisher.on_demand``."""
        self._demand.append(callback)
        if (count := self.subscribers) is not None:
            callback(count)

    def set_subscribers(self, count: int | None) -> None:
        """Note how many read it, and tell a change."""
        if count != self._subscribers:
            self._subscribers = count
            self._tell_demand(count or 0)

    def _tell_demand(self, count: int) -> None:
        for callback in self._demand:
            self._graph.guard(self.topic, callback, count)

    def _numbered(self, sample: Sample, origin: bytes) -> Sample:
        """Return a sample without a number (``SEQ_NONE``) as one that ``origin`` publishes first."""
        made = numbered(sample, self.type, origin, self._seq)
        self._seq = made.seq
        return made


class SubscriptionBase(Generic[H]):
    """The base of subscriptions: holds the profile, reports its changes, and calls back with messages.

    ``asked`` is the profile that was asked for, ``None`` where that of the publishers is adopted.
    """

    def __init__(self, graph: H, topic: str, type: str, qos: QoS | None, callback: SampleCallback) -> None:
        self.topic, self.type = topic, type
        self.asked = qos
        self.closed = False
        self._graph = graph
        self._qos = qos or DEFAULT
        self._callback = callback
        self._qos_callbacks: list[Callable[[QoS], None]] = []

    @property
    def qos(self) -> QoS:
        """Return the profile in use."""
        return self._qos

    def on_qos(self, callback: Callable[[QoS], None]) -> None:
        """See ``Subscription.on_qos``."""
        self._qos_callbacks.append(callback)
        callback(self._qos)

    def set_qos(self, qos: QoS) -> None:
        """Use another profile, and tell a change."""
        if qos != self._qos:
            self._qos = qos
            self._tell_qos()

    def adopt(self, offered: Iterable[QoS]) -> None:
        """Use the profile that fits what writers offer, as far as none was asked for."""
        self.set_qos(adopted(self.asked, offered, self._qos))

    def _tell_qos(self) -> None:
        for callback in self._qos_callbacks:
            self._graph.guard(self.topic, callback, self._qos)

    def deliver(self, batch: Sequence[Sample]) -> None:
        """Hand messages to the callback; those that it fails on are counted, and cost nobody else anything."""
        if self.closed or not batch:
            return
        try:
            self._callback(batch)
        except Exception:  # a callback is somebody else's code
            self._callback_failed(batch)

    def _callback_failed(self, batch: Sequence[Sample]) -> None:
        self._graph.drops[self.topic, Undelivered.CALLBACK] += len(batch)
        failed(log, "%s: a callback for %s failed", self._graph.name, self.topic)


class ClientBase(Generic[H]):
    """A service that is called: waiting for who serves it, and the end of all calls with ``close``.

    A network says with ``available`` whether somebody serves it, notifies ``changed`` when that may have changed,
    makes calls in ``_call`` and forgets the client in ``_leave``.
    """

    def __init__(self, graph: H, service: str, type: str) -> None:
        self.service, self.type = service, type
        self.closed = False
        self.changed = Signal()
        self._graph = graph
        self._under_way = InFlight()

    @property
    def available(self) -> bool | None:
        """See ``Client.available``."""
        raise NotImplementedError

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``Client.wait_available``."""
        await self.changed.wait_for(lambda: self.closed or self.available is not False, timeout_s)
        return self.available is not False

    async def call(self, request: Request, timeout_s: float = DEFAULT_TIMEOUT_S) -> bytes:
        """See ``Client.call``."""
        self._check_open()
        with self._under_way.call():
            return await self._call(request, timeout_s)

    async def _call(self, request: Request, timeout_s: float) -> bytes:
        raise NotImplementedError

    async def close(self) -> None:
        """See ``Client.close``."""
        if self.closed:
            return
        self.closed = True
        self.changed.notify()
        await self._under_way.fail(self._closed_in_mid_call())
        await self._leave()

    async def _leave(self) -> None:
        """Make the graph forget the client."""

    def _check_open(self) -> None:
        if self.closed:
            raise GraphUnavailable(self._graph.name, f"the client of {self.service} is closed")

    def _closed_in_mid_call(self) -> GraphUnavailable:
        return GraphUnavailable(self._graph.name, f"the client of {self.service} was closed in mid-call")
