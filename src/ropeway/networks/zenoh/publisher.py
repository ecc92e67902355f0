"""Publishes a topic as rmw_zenoh does."""

from __future__ import annotations

import time
from functools import partial
from typing import Any, Final, Protocol

import zenoh
import zenoh.ext

from ropeway.errors import TypesError
from ropeway.graph.base import SEQ_NONE, Sample, Undelivered
from ropeway.graph.history import History
from ropeway.graph.host import Host
from ropeway.graph.parts import PublisherBase
from ropeway.networks.zenoh.attachment import pack
from ropeway.networks.zenoh.discovery import ZenohDiscovery
from ropeway.networks.zenoh.hashed_layouts import HashedLayouts
from ropeway.networks.zenoh.sender import Sender, ZenohLane
from ropeway.networks.zenoh.session import ZenohPresence, ZenohSession
from ropeway.qos import QoS

__all__ = ["ZenohPublisher", "ZenohTopicHost"]

_HEARTBEAT_S: Final = 0.5  # as rmw_zenoh: by it a reader learns that it missed the last message


class ZenohTopicHost(Host, Protocol):
    """The services of a graph for its topics."""

    session: ZenohSession
    sender: Sender
    layouts: HashedLayouts
    discovery: ZenohDiscovery

    def withdraw(self, part: ZenohPublisher) -> None:
        """Forget a publisher that was closed."""
        ...


class _Outlet:
    """A publisher of Zenoh's under one hash of the type, with what it keeps for late joiners."""

    def __init__(self, session: ZenohSession, key: str, qos: QoS, type_hash: str, gid: bytes) -> None:
        self.type_hash, self.gid = type_hash, gid
        self._session = session
        latched = qos.transient_local
        heartbeat = latched and qos.reliable
        self._raw: Any = session.attempt(
            lambda: zenoh.ext.declare_advanced_publisher(
                session.raw,
                key,
                congestion_control=zenoh.CongestionControl.DROP,
                reliability=zenoh.Reliability.RELIABLE if qos.reliable else zenoh.Reliability.BEST_EFFORT,
                cache=zenoh.ext.CacheConfig(max(qos.depth, 1)) if latched else None,
                publisher_detection=latched,
                sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S)
                if heartbeat
                else None,
            )
        )
        self.put = self._raw.put

    def close(self) -> None:
        self._session.undeclare(self._raw)


class ZenohPublisher(PublisherBase[ZenohTopicHost]):
    """Publishes what it is given as it is, with ``sample.seq`` as the source timestamp where there is one.

    Readers that know the type under another hash get each message in their layout, under their key.
    """

    def __init__(self, graph: ZenohTopicHost, topic: str, type: str, qos: QoS, type_hash: str) -> None:
        super().__init__(graph, topic, type, qos)
        self._session = graph.session
        self._number = 0
        self._history = History(qos)
        self._lane = ZenohLane(self._lost, None if qos.reliable or qos.history == "keep_all" else max(qos.depth, 1))
        self._presence = ZenohPresence(graph.session, "publisher", topic, type, type_hash, qos)
        self._outlets: tuple[_Outlet, ...] = (self._make(type_hash),)

    def publish(self, sample: Sample) -> None:
        """Send, without waiting; what Zenoh does not take is counted."""
        if self.closed:
            self._graph.drops[self.topic, Undelivered.CLOSED] += 1
            return
        self._number += 1
        stamp_ns = sample.seq if sample.seq != SEQ_NONE else time.time_ns()
        if self.qos.transient_local:
            self._history.add(Sample(sample.payload, self.type, sample.stamp_ns or stamp_ns, sample.origin, stamp_ns))
        for outlet in self._outlets:
            self._put(outlet, sample.payload, stamp_ns)

    def follow(self) -> None:
        """See who reads the topic, and under which hashes."""
        readers = self._graph.discovery.others("subscription", self.topic, self.type)
        new, gone = self._presence.follow(token.type_hash for token in readers)
        if gone:
            for outlet in self._outlets:
                if outlet.type_hash in gone:
                    outlet.close()
            self._outlets = tuple(outlet for outlet in self._outlets if outlet.type_hash not in gone)
        for type_hash in new:
            outlet = self._make(type_hash)
            for kept in self._history.replay():
                self._put(outlet, kept.payload, kept.seq)
            self._outlets = (*self._outlets, outlet)
        self.set_subscribers(len({(token.session, token.id) for token in readers}))

    async def close(self) -> None:
        """Withdraw the topic, after what waits was sent."""
        if self.closed:
            return
        self.closed = True
        self._demand.clear()
        self.set_subscribers(0)
        self._graph.withdraw(self)
        await self._graph.sender.finish(self._lane)
        self._presence.close()
        for outlet in self._outlets:
            outlet.close()

    def _make(self, type_hash: str) -> _Outlet:
        key = self._session.key(self.topic, self.type, type_hash)
        return _Outlet(self._session, key, self.qos, type_hash, self._presence.gid(type_hash))

    def _put(self, outlet: _Outlet, payload: bytes, stamp_ns: int) -> None:
        try:
            payload = self._graph.layouts.write(self.type, payload, outlet.type_hash)
        except TypesError:
            self._graph.drops[self.topic, Undelivered.ENCODE] += 1
            return
        attachment = pack(self._number, stamp_ns, outlet.gid)
        self._graph.sender.send(self._lane, partial(outlet.put, payload, attachment=attachment), len(payload))

    def _lost(self, count: int) -> None:
        self._graph.drops[self.topic, Undelivered.WRITE] += count
