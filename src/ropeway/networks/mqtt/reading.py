"""Reads topics of a broker: feeds, one for each topic or filter that is read, and the subscriptions that share them."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, Protocol

from ropeway.errors import ConversionError
from ropeway.graph.base import Sample, SampleCallback, Undelivered
from ropeway.graph.timed_messages import TimedHost, TimedSubscription
from ropeway.limits import MQTT_KEPT_BYTES, MQTT_KEPT_TOPICS
from ropeway.networks.mqtt.connection import Wish
from ropeway.networks.mqtt.maps import MqttMap, form_of
from ropeway.networks.mqtt.names import is_pattern, matches
from ropeway.networks.mqtt.wire import Received
from ropeway.qos import QoS
from ropeway.tasks import describe
from ropeway.types.forms import FAILURES, CdrForm

if TYPE_CHECKING:
    from ropeway.fault_log import FaultLog
    from ropeway.types import TypeRegistry

__all__ = ["MqttFeed", "MqttFeeds", "MqttReadingHost", "MqttSubscription"]

_MATCHED_TOPICS: Final = 4096  # of filters: which feeds a topic belongs to is looked up once


class MqttReadingHost(TimedHost, Protocol):
    """The services of a graph for what it reads."""

    registry: TypeRegistry
    fault_log: FaultLog

    def offered(self, topic: str) -> list[QoS]:
        """Return the profiles of those who publish a ROS topic."""
        ...

    def came(self, topic: str, sample: Sample) -> None:
        """Note that a sample came from a topic of the broker, so that it does not go back."""
        ...

    def asked(self, feed: MqttFeed) -> None:
        """Read a feed with what its subscriptions want now."""
        ...

    async def forget(self, subscription: MqttSubscription) -> None:
        """Remove a closed subscription."""
        ...


class MqttFeed:
    """Receives one topic, or all that match a filter, for all subscriptions that read it."""

    def __init__(self, filter: str) -> None:
        self.filter = filter
        self.refused = ""
        self.readers: list[MqttSubscription] = []
        self._last: OrderedDict[str, Received] = OrderedDict()  # by topic, where a late joiner may want it
        self._last_bytes = 0

    @property
    def wish(self) -> Wish:
        """Return how the broker is asked for the topic, on behalf of all subscriptions."""
        return Wish(
            int(any(reader.qos.reliable for reader in self.readers)),
            any(reader.wants_retained for reader in self.readers),
        )

    def take(self, message: Received) -> None:
        """Give a message to those who want it; the last value that the broker repeats only to who has not had it."""
        for reader in list(self.readers):
            if not message.retained or reader.qos.transient_local:
                reader.take(message)
        if any(reader.wants_retained for reader in self.readers):
            self._keep(message)

    def catch_up(self, reader: MqttSubscription) -> None:
        """Give a late joiner the last values that are known here."""
        for message in list(self._last.values()):
            reader.take(message)

    def _keep(self, message: Received) -> None:
        before = self._last.pop(message.topic, None)
        self._last[message.topic] = message
        self._last_bytes += len(message.payload) - (0 if before is None else len(before.payload))
        while len(self._last) > 1 and (len(self._last) > MQTT_KEPT_TOPICS or self._last_bytes > MQTT_KEPT_BYTES):
            self._last_bytes -= len(self._last.popitem(last=False)[1].payload)


class MqttFeeds:
    """The feeds of a graph, by their filters."""

    def __init__(self) -> None:
        self._feeds: dict[str, MqttFeed] = {}
        self._patterns: list[MqttFeed] = []
        self._matched: dict[str, tuple[MqttFeed, ...]] = {}

    def get(self, filter: str) -> MqttFeed | None:
        """Return the feed of a filter."""
        return self._feeds.get(filter)

    def add(self, filter: str) -> MqttFeed:
        """Make a feed."""
        feed = self._feeds[filter] = MqttFeed(filter)
        if is_pattern(filter):
            self._patterns.append(feed)
        self._matched.clear()
        return feed

    def remove(self, feed: MqttFeed) -> None:
        """Take a feed out."""
        del self._feeds[feed.filter]
        if feed in self._patterns:
            self._patterns.remove(feed)
        self._matched.clear()

    def of(self, topic: str) -> tuple[MqttFeed, ...]:
        """Return the feeds that a message of a topic goes to."""
        found = self._matched.get(topic)
        if found is None:
            if len(self._matched) >= _MATCHED_TOPICS:
                self._matched.clear()
            own = self._feeds.get(topic)
            found = (*(() if own is None else (own,)), *(f for f in self._patterns if matches(f.filter, topic)))
            self._matched[topic] = found
        return found

    def __iter__(self) -> Iterator[MqttFeed]:
        return iter(list(self._feeds.values()))


class MqttSubscription(TimedSubscription[MqttReadingHost, str]):
    """A ROS topic that is read from a broker."""

    def __init__(
        self,
        graph: MqttReadingHost,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        map: MqttMap | None,
    ) -> None:
        super().__init__(graph, topic, type, qos, callback)
        _, self._form = form_of(map, type, graph.registry)
        self._cdr = CdrForm(graph.registry.codec(type))
        self.feed: MqttFeed | None = None
        self._had: dict[str, Received] = {}

    @property
    def wants_retained(self) -> bool:
        """Whether it wants the last value, as far as it knows: who adopts a profile learns it from that value."""
        return self.asked is None or self.asked.adopts or self.qos.transient_local

    @property
    def refused(self) -> str:
        """See ``Refusable.refused``."""
        return self.feed.refused if self.feed is not None else ""

    def join(self, feed: MqttFeed) -> None:
        """Read a feed."""
        self.feed = feed
        feed.readers.append(self)
        if self.qos.transient_local:
            feed.catch_up(self)

    def readopt(self) -> None:
        """Follow the publishers' profiles, where it was made to."""
        if self.closed or not (self.asked is None or self.asked.adopts):
            return
        before = self.qos
        self.adopt(self._graph.offered(self.topic))
        if self.feed is None or self.qos == before:
            return
        if self.qos.transient_local:
            self.feed.catch_up(self)
        if self.qos.reliable != before.reliable:
            self._graph.asked(self.feed)

    def take(self, message: Received) -> None:
        """Convert a message and hand it over in the next turn of the loop."""
        if self.closed:
            return
        if self.wants_retained:
            if message.repeats(self._had.get(message.topic)) and (message.retained or message.told):
                return
            if len(self._had) >= MQTT_KEPT_TOPICS:
                self._had.clear()
            self._had[message.topic] = message
        try:
            if message.type and message.type != self.type:
                raise ConversionError(f"it is a {message.type}, not a {self.type}")
            made = (self._cdr if message.form == "cdr" else self._form).messages(message.payload)
        except FAILURES as error:
            self._graph.drops[self.topic, Undelivered.DECODE] += 1
            why = f"it is not passed on to {self.topic}: {describe(error)}"
            self._graph.fault_log.note("value", message.topic, why)
            return
        now_ns = time.time_ns()
        self._hand_over(
            message.topic, made, lambda payload: Sample(payload, self.type, now_ns, message.origin, message.seq)
        )

    def _came(self, source: str, sample: Sample) -> None:
        self._graph.came(source, sample)

    async def close(self) -> None:
        """Stop reading."""
        if self.closed:
            return
        self.closed = True
        self._drop_timers()
        self._had.clear()
        await self._graph.forget(self)
