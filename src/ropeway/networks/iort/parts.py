"""Topics of the ``iort`` graph: publishers write text, subscriptions read it."""

from __future__ import annotations

import hashlib
import time
from typing import TYPE_CHECKING, Final, Protocol

from ropeway.graph.base import Sample, SampleCallback, Undelivered
from ropeway.graph.parts import PublisherBase
from ropeway.graph.timed_messages import TimedHost, TimedSubscription
from ropeway.qos import QoS
from ropeway.store import CDR, Entry
from ropeway.tasks import describe
from ropeway.types.forms import FAILURES, Form, Timed, default_form

if TYPE_CHECKING:
    from ropeway.fault_log import FaultLog
    from ropeway.graph.deduplication import Seen
    from ropeway.networks.iort.links import Link
    from ropeway.networks.iort.maps import TopicMap
    from ropeway.types import TypeRegistry

__all__ = ["ROS_ORIGIN", "IortPublisher", "IortSubscription", "NodeTopic"]

_NANOSECONDS: Final = 1 << 59  # a number above is a time stamp, not a count

ROS_ORIGIN: Final = "ros:"
"""The prefix of the origin of entries that ROS published first; 32 hexadecimal digits follow."""


class IortHost(TimedHost, Protocol):
    """The services of a graph for its publishers and subscriptions."""

    link: Link
    registry: TypeRegistry
    fault_log: FaultLog

    @property
    def own_mark(self) -> str:
        """The end of the origin of every message of ours."""
        ...

    def resolved(self, topic: str, direction: str) -> list[tuple[str, str, TopicMap | None]]:
        """Return where a ROS topic goes to or comes from, and by which map."""
        ...

    def offered(self, topic: str) -> list[QoS]:
        """Return the profiles of those who publish a topic."""
        ...

    def had(self, system: str, topic: str) -> Seen:
        """Return what has come from a topic of a robot, which need not go back."""
        ...

    async def withdraw(self, publisher: IortPublisher) -> None:
        """Remove a closed publisher."""
        ...

    async def forget(self, subscription: IortSubscription) -> None:
        """Remove a closed subscription."""
        ...


class IortPublisher(PublisherBase[IortHost]):
    """A ROS topic published to the nodes behind it."""

    def __init__(self, graph: IortHost, topic: str, type: str, qos: QoS) -> None:
        super().__init__(graph, topic, type, qos)
        self._subscribers = None  # nodes read when they like, from the store
        self.targets: list[tuple[str, str, Form, TopicMap | None]] = [
            (system, name, map.make_form(graph.registry) if map else default_form(type, graph.registry), map)
            for system, name, map in graph.resolved(topic, "out")
        ]

    def publish(self, sample: Sample) -> None:
        """Convert and send; what cannot be converted is counted."""
        graph = self._graph
        if self.closed:
            graph.drops[self.topic, Undelivered.CLOSED] += 1
            return
        stamp_ns = sample.seq if sample.seq > _NANOSECONDS else sample.stamp_ns or time.time_ns()
        origin = f"{ROS_ORIGIN}{sample.origin.hex()}{graph.own_mark}"
        for system, topic, form, map in self.targets:
            if graph.had(system, topic).has(sample):
                continue  # it came from there
            try:
                data = form.text(bytes(sample.payload))
            except FAILURES as error:
                graph.drops[self.topic, Undelivered.ENCODE] += 1
                graph.fault_log.note("message", f"{system}/{topic}", f"it is not passed on: {describe(error)}")
                continue
            if data is None:
                continue
            type = "" if map is not None else self.type
            if not graph.link.publish(system, topic, data, type, stamp_ns, origin, ""):
                graph.drops[self.topic, Undelivered.WRITE] += 1

    async def close(self) -> None:
        """Withdraw the topic; its last value stays."""
        if not self.closed:
            self.closed = True
            await self._graph.withdraw(self)


class NodeTopic:
    """Receives one topic of nodes, for all subscriptions that read it."""

    def __init__(self, system: str, topic: str) -> None:
        self.system, self.topic = system, topic
        self.last: Entry | None = None
        self.readers: list[tuple[IortSubscription, Form | None]] = []

    def take(self, entry: Entry, latest: bool) -> None:
        """Take a value; ``latest`` marks one that was there before."""
        if self.last is None or self.last.order <= entry.order:
            self.last = entry
        for subscription, form in list(self.readers):
            if not latest or subscription.qos.transient_local or subscription.had(self):
                subscription.take(self, entry, form)


class IortSubscription(TimedSubscription[IortHost, NodeTopic]):
    """A ROS topic that nodes publish."""

    def __init__(self, graph: IortHost, topic: str, type: str, qos: QoS | None, callback: SampleCallback) -> None:
        super().__init__(graph, topic, type, qos, callback)
        self._plain: Form | None = None
        self._feeds: list[tuple[NodeTopic, Form | None]] = []
        self._had: dict[int, tuple[int, str]] = {}

    def join(self, feed: NodeTopic, form: Form | None) -> None:
        """Read a topic of nodes; ``form`` is that of its map."""
        feed.readers.append((self, form))
        self._feeds.append((feed, form))
        self._catch_up()

    def had(self, feed: NodeTopic) -> bool:
        """Return whether it had a value of this topic: after a cut the newest comes again."""
        return id(feed) in self._had

    def readopt(self) -> None:
        """Follow the publishers' profiles, where it was made to."""
        if self.asked is not None or self.closed:
            return
        self.adopt(self._graph.offered(self.topic))
        self._catch_up()

    def _catch_up(self) -> None:
        if self._qos.transient_local:
            for feed, form in self._feeds:
                if feed.last is not None:
                    self.take(feed, feed.last, form)

    def take(self, feed: NodeTopic, entry: Entry, form: Form | None) -> None:
        """Convert a value and hand it over in the next turn of the loop."""
        if self.closed or self._had.get(id(feed), (-1, "")) >= entry.order:
            return
        self._had[id(feed)] = entry.order
        try:
            messages = self._messages(entry, form)
        except FAILURES as error:
            self._graph.drops[self.topic, Undelivered.DECODE] += 1
            where = f"{entry.system}/{entry.topic}"
            self._graph.fault_log.note("value", where, f"it is not passed on to {self.topic}: {describe(error)}")
            return
        self._hand_over(
            feed, messages, lambda payload: Sample(payload, self.type, time.time_ns(), _origin(entry), entry.stamp_ns)
        )

    def _came(self, source: NodeTopic, sample: Sample) -> None:
        self._graph.had(source.system, source.topic).add(sample)

    def _messages(self, entry: Entry, form: Form | None) -> list[Timed]:
        if entry.form == CDR:
            if entry.type != self.type:
                raise ValueError(f"{entry.type} is not {self.type}")
            return [(0.0, entry.data)]
        if form is None:
            if self._plain is None:
                self._plain = default_form(self.type, self._graph.registry)
            form = self._plain
        return form.messages(entry.data)

    async def close(self) -> None:
        """Stop reading."""
        if self.closed:
            return
        self.closed = True
        self._drop_timers()
        await self._graph.forget(self)


def _origin(entry: Entry) -> bytes:
    """Return 16 bytes: those of the first publisher, if it was a ROS graph."""
    text = entry.origin
    if text.startswith(ROS_ORIGIN):
        try:
            raw = bytes.fromhex(text.removeprefix(ROS_ORIGIN)[:32])
        except ValueError:
            raw = b""
        if len(raw) == 16 and any(raw):
            return raw
    return hashlib.sha256(text.encode()).digest()[:16]
