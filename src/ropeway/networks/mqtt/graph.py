"""The ``mqtt`` graph: topics of a broker, of which ``factory/robot1/odom`` appears as ``/factory/robot1/odom``.

Payloads are texts, JSON or bytes on one side and CDR on the other; ``maps`` says how they are converted. A topic
without a map has the type with which it is read or published: one with a single value is that value, an array of bytes
is bytes, and others are JSON.
"""

from __future__ import annotations

import asyncio
import ssl
from collections import Counter
from dataclasses import replace
from typing import Any, Final

from paho.mqtt.client import MQTTMessage

from ropeway.errors import GraphUnavailable, TypeConflict
from ropeway.fault_log import FaultLog
from ropeway.graph.base import (
    NO_HINTS,
    Delivery,
    EndpointInfo,
    GraphEvent,
    NodeInfo,
    Sample,
    SampleCallback,
    TopicInfo,
    Undelivered,
    new_origin,
    resolve_name,
)
from ropeway.graph.calls import (
    ActionInfo,
    ServiceInfo,
)
from ropeway.graph.deduplication import Seen
from ropeway.graph.topics_only import TopicsOnlyGraph
from ropeway.networks.mqtt.address import MqttAddress
from ropeway.networks.mqtt.connection import MqttConnection, Wish
from ropeway.networks.mqtt.dialling import ConnectionPlan
from ropeway.networks.mqtt.discovery import UNLISTED, MqttDiscovery
from ropeway.networks.mqtt.echoes import Echoes
from ropeway.networks.mqtt.maps import MqttMap, MqttMaps
from ropeway.networks.mqtt.outgoing import MqttOutgoing
from ropeway.networks.mqtt.peeks import Peeks
from ropeway.networks.mqtt.presence import Announced, id_of, pack_announcement, parse_announcement
from ropeway.networks.mqtt.publisher import MqttPublisher
from ropeway.networks.mqtt.reading import MqttFeed, MqttFeeds, MqttSubscription
from ropeway.networks.mqtt.wire import Received, read_message
from ropeway.qos import DEFAULT, QoS
from ropeway.tasks import Chores
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name

__all__ = ["MqttGraph"]

_HAD_LIMIT: Final = 4096
_ANNOUNCE_S: Final = 0.02  # what begins together is told together
_EXPIRE_S: Final = 60.0
_LOOK_S: Final = 1.0  # in which the broker has sent all values that it keeps
_WAIT_S: Final = 5.0


class MqttGraph(TopicsOnlyGraph):
    """Topics of the broker at ``address``.

    ``discover`` are the filters of topics that are looked at to list them, over a connection of its own. With
    ``wait_s`` 0 the broker need not be reached when the graph opens.
    """

    kind = "mqtt"
    no_calls = "has topics only: MQTT knows neither services nor actions"

    def __init__(
        self,
        address: MqttAddress,
        *,
        node: str = "ropeway",
        user: str = "",
        password: str | None = None,
        ssl_context: ssl.SSLContext | None = None,
        maps: MqttMaps | None = None,
        discover: tuple[str, ...] = (),
        registry: TypeRegistry | None = None,
        wait_s: float = _WAIT_S,
        max_message_bytes: int = 64 << 20,
    ) -> None:
        super().__init__(address.url)
        self.node = f"/{node}"
        self.maps = maps or MqttMaps()
        self.registry = registry or TypeRegistry()
        self.fault_log = FaultLog(self.name)
        self.origin = new_origin()
        self.loop: asyncio.AbstractEventLoop
        self.connection: MqttConnection
        self.outgoing: MqttOutgoing
        self.discovery: MqttDiscovery
        self._prefix, self._discover, self._wait_s = address.announce, discover, wait_s
        client_id = address.client_id or f"ropeway-{node}-{self.origin.hex()[:8]}"
        self._presence_topic = f"{self._prefix}/{self.origin.hex()}" if self._prefix else ""
        if address.tls and ssl_context is None:
            ssl_context = ssl.create_default_context()
        self._plan = ConnectionPlan(
            address.host,
            address.port,
            client_id,
            user or address.user,
            password,
            ssl_context if address.tls else None,
            address.version,
            address.keep_alive_s,
            max_message_bytes,
            self._presence_topic,
        )
        self._watch: MqttConnection | None = None
        self._watch_since_s = 0.0
        self._publishers: list[MqttPublisher] = []
        self._targets: Counter[str] = Counter()
        self._subscriptions: dict[str, list[MqttSubscription]] = {}
        self._feeds = MqttFeeds()
        self._had: dict[str, Seen] = {}
        self._echoes = Echoes()
        self._chores = Chores()
        self.peeks: Peeks
        self._announcing: asyncio.TimerHandle | None = None
        self._unannounced = False
        self._expiring: asyncio.TimerHandle | None = None

    # ── joining and leaving ────────────────────────────────────────────────────────────────────────────────────

    async def _join(self) -> None:
        self.loop = asyncio.get_running_loop()
        connection = self.connection = MqttConnection(self.name, self._plan)
        self.outgoing = MqttOutgoing(connection)
        self.discovery = MqttDiscovery(self.name, self.maps, self._changed, self.drops)
        self.peeks = Peeks(connection, self._feeds, self.maps, self._chores)
        connection.on_messages = self._take
        connection.on_state = self._state_changed
        connection.on_ready = self._ready
        connection.on_published = self.outgoing.published
        connection.on_refused = self._refused
        if self._prefix:
            await connection.subscribe(f"{self._prefix}/+", Wish(1, retained=True))
        await connection.open(self._wait_s)
        if self._discover:
            watch = self._watch = MqttConnection(
                self.name, replace(self._plan, client_id=f"{self._plan.client_id}-list", will_topic="")
            )
            watch.on_messages = self._look_at
            for filter in self._discover:
                await watch.subscribe(filter, Wish(0, retained=True))
            await watch.open(0.0)
            self._watch_since_s = self.loop.time()
        self._expire()

    async def _close_parts(self) -> None:
        await asyncio.gather(*(publisher.close() for publisher in list(self._publishers)))
        for subscriptions in list(self._subscriptions.values()):
            for subscription in list(subscriptions):
                await subscription.close()

    async def _leave(self) -> None:
        for timer in (self._announcing, self._expiring):
            if timer is not None:
                timer.cancel()
        self._announcing = self._expiring = None
        if self._presence_topic and self.connection.connected:
            self.connection.publish(self._presence_topic, b"", 1, True, None)
        if self._watch is not None:
            await self._watch.close()
            self._watch = None
        await self.connection.close()
        await self._chores.close()
        self.discovery.clear()
        self._had.clear()

    def renew(self, password: str | None, ssl_context: ssl.SSLContext | None, *, anew: bool) -> None:
        """Use other credentials from the next connection on; with ``anew`` at once."""
        self._plan = replace(self._plan, password=password, context=ssl_context)
        if self._is_open:
            self.connection.renew(self._plan, anew=anew)

    @property
    def connected(self) -> bool:
        """Whether the broker is there."""
        return self._is_open and self.connection.connected

    def status(self) -> dict[str, Any]:
        """Return how the connection with the broker is, for people and programs."""
        if not self._is_open:
            return {"error": "not open"}
        return {
            "error": "" if self.connected else self.connection.error,
            "dials": self.connection.dials,
            "waiting": self.outgoing.waiting,
            "faults": sum(self.fault_log.counts.values()),
            "drops": {f"{topic}: {why.value}": n for (topic, why), n in self.drops.items() if n},
        }

    @property
    def settled(self) -> bool:
        """See ``Settling.settled``: what the broker keeps comes at once, the rest when it is published."""
        return self._watch is None or self.loop.time() - self._watch_since_s > _LOOK_S

    # ── parts ──────────────────────────────────────────────────────────────────────────────────────────────────

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> MqttPublisher:
        """Publish ``topic`` to the broker. Raises ``TypeConflict`` where its map has another type."""
        topic, type = self._check(topic, type)
        target, map = self._at(topic, type, "out")
        publisher = MqttPublisher(self, topic, type, qos or DEFAULT, target, map, delivery)
        self._publishers.append(publisher)
        self._targets[target] += 1
        self._announce_soon()
        return publisher

    async def create_subscription(
        self,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> MqttSubscription:
        """Read ``topic`` from the broker. Raises ``TypeConflict`` where its map has another type, and
        ``GraphUnavailable`` where the broker refuses it.
        """
        topic, type = self._check(topic, type)
        filter, map = self._at(topic, type, "in")
        subscription = MqttSubscription(self, topic, type, qos, callback, map)
        subscription.readopt()
        feed = self._feeds.get(filter)
        before = feed.wish if feed is not None else None
        feed = feed or self._feeds.add(filter)
        self._subscriptions.setdefault(topic, []).append(subscription)
        subscription.join(feed)
        self._announce_soon()
        if feed.wish != before:
            feed.refused = await self.connection.subscribe(filter, feed.wish)
        if feed.refused:
            why = feed.refused
            await subscription.close()
            raise GraphUnavailable(self.name, f"the broker does not let {filter} be read: {why}")
        return subscription

    # ── what is there ──────────────────────────────────────────────────────────────────────────────────────────

    def topics(self) -> dict[str, TopicInfo]:
        """Return every topic that a gateway announces, or on which a message was seen, and our own."""
        names = {*self.discovery.names(), *self._subscriptions, *(part.topic for part in self._publishers)}
        return {name: self._topic(name) for name in sorted(names)}

    def counts(self) -> tuple[int, int]:
        """See ``Graph.counts``."""
        own = {*self._subscriptions, *(part.topic for part in self._publishers)}
        return len(self.discovery.names() | own), len(self.nodes())

    def look_up(self, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None:
        """See ``Graph.look_up``; whether the broker keeps a value of a topic is found out for who asks first."""
        if kind != "topic":
            return None
        found = self._topic(name)
        if not found.publishers:
            self.peeks.want(name)
        return found if found.types else None

    def nodes(self) -> dict[str, NodeInfo]:
        """Return the gateways that announce what they publish and read."""
        return self.discovery.nodes()

    def _topic(self, name: str) -> TopicInfo:
        parts = [("publisher", part) for part in self._publishers if part.topic == name]
        own = [EndpointInfo(kind, name, part.type, part.qos, node=self.node, local=True) for kind, part in parts]
        own += [
            EndpointInfo("subscription", name, part.type, part.qos, node=self.node, local=True)
            for part in self._subscriptions.get(name, ())
        ]
        ends = [*self.discovery.of(name), *own]
        publishers = tuple(end for end in ends if end.kind == "publisher")
        subscriptions = tuple(end for end in ends if end.kind != "publisher")
        return TopicInfo(name, tuple(dict.fromkeys(end.type for end in ends)), publishers, subscriptions)

    # ── for the parts ──────────────────────────────────────────────────────────────────────────────────────────

    def offered(self, topic: str) -> list[QoS]:
        """See ``MqttReadingHost``."""
        return self.discovery.offered(topic)

    def had(self, topic: str) -> Seen | None:
        """See ``MqttPublisherHost``."""
        return self._had.get(topic)

    def came(self, topic: str, sample: Sample) -> None:
        """See ``MqttReadingHost``."""
        had = self._had.get(topic)
        if had is None:
            if len(self._had) >= _HAD_LIMIT:
                self._had.clear()
            had = self._had[topic] = Seen()
        had.add(sample)

    def sent(self, topic: str, payload: bytes) -> None:
        """See ``MqttPublisherHost``."""
        if self._feeds.of(topic):
            self._echoes.sent(topic, payload)

    def asked(self, feed: MqttFeed) -> None:
        """See ``MqttReadingHost``."""
        self._chores.start(self.connection.subscribe(feed.filter, feed.wish), f"{self.name}: reading {feed.filter}")

    def withdraw(self, publisher: MqttPublisher) -> None:
        """See ``MqttPublisherHost``."""
        self._publishers.remove(publisher)
        self._targets -= Counter((publisher.target,))
        self._announce_soon()

    async def forget(self, subscription: MqttSubscription) -> None:
        """See ``MqttReadingHost``."""
        same = self._subscriptions.get(subscription.topic, [])
        if subscription in same:
            same.remove(subscription)
            if not same:
                del self._subscriptions[subscription.topic]
        feed = subscription.feed
        if feed is not None:
            feed.readers.remove(subscription)
            if not feed.readers:
                self._feeds.remove(feed)
                self.connection.unsubscribe(feed.filter)
        self._announce_soon()

    # ── inside ─────────────────────────────────────────────────────────────────────────────────────────────────

    def _check(self, topic: str, type: str) -> tuple[str, str]:
        self._check_open()
        if not type:
            raise TypeConflict(topic, "a type", "none")
        return resolve_name(topic), canonical_name(type, "msg")

    def _at(self, topic: str, type: str, direction: str) -> tuple[str, MqttMap | None]:
        found, map = self.maps.at(topic, direction)
        if map is not None and map.type != type:
            raise TypeConflict(topic, map.type, type)
        return found, map

    def _changed(self, event: GraphEvent) -> None:
        if event.kind == "publisher":
            for subscription in list(self._subscriptions.get(event.name, ())):
                subscription.readopt()
        self._changes.emit(event)

    def _read(self, message: MQTTMessage) -> Received | None:
        """Return a message that can be used; count one that cannot."""
        found = read_message(message, self.name)
        if found is None:
            self.drops[UNLISTED, Undelivered.DECODE] += 1
            self.fault_log.note("message", "", "the name of its topic is not UTF-8 text")
        elif len(found.payload) > self._plan.max_message_bytes:
            self.drops[UNLISTED, Undelivered.DECODE] += 1
            self.fault_log.note("size", found.topic, f"{len(found.payload)} bytes are more than max_message_bytes")
            return None
        return found

    def _take(self, batch: list[MQTTMessage]) -> None:
        """Take what the broker has sent."""
        for message in batch:
            found = self._read(message)
            if found is None:
                continue
            topic = found.topic
            if self._prefix and (id := id_of(topic, self._prefix)):
                self._announced(id, found)
                continue
            if not self._plan.five and self._echoes.is_own(topic, found.payload):
                continue
            if topic not in self._targets:
                self.discovery.see(found)
            for feed in self._feeds.of(topic):
                feed.take(found)

    def _look_at(self, batch: list[MQTTMessage]) -> None:
        """Note on which topics something comes."""
        for message in batch:
            found = self._read(message)
            if found is not None and found.topic not in self._targets and not id_of(found.topic, self._prefix):
                self.discovery.see(found)

    def _announced(self, id: str, message: Received) -> None:
        if id == self.origin.hex():
            return
        announcement = parse_announcement(message.payload) if message.payload else None
        if announcement is None and message.payload:
            self.drops[UNLISTED, Undelivered.DECODE] += 1
            self.fault_log.note("message", message.topic, "it is no announcement of a gateway")
        self.discovery.announce(id, announcement)

    def _refused(self, filter: str, why: str) -> None:
        feed = self._feeds.get(filter)
        if feed is not None:
            feed.refused = why
        self.fault_log.note("topic", filter, f"the broker does not let it be read: {why}")

    def _state_changed(self, connected: bool) -> None:
        if connected:
            self._announce()
            self.peeks.again()
            self.outgoing.resume()
        else:
            self.outgoing.lose()
            self.discovery.clear()
            self._echoes.clear()

    def _ready(self) -> None:
        if self._unannounced:
            self._announce()
        self.outgoing.pump()

    def _announce_soon(self) -> None:
        if self._presence_topic and self._announcing is None and self._is_open:
            self._announcing = self.loop.call_later(_ANNOUNCE_S, self._announce)

    def _announce(self) -> None:
        """Tell the other gateways at the broker what is published and read here."""
        if self._announcing is not None:
            self._announcing.cancel()
            self._announcing = None
        if not self._presence_topic:
            return
        self._unannounced = not self.connection.free
        if self._unannounced:
            return
        ends = [Announced("publisher", part.target, part.type, part.qos) for part in self._publishers]
        for feed in self._feeds:
            ends += [Announced("subscription", feed.filter, part.type, part.qos) for part in feed.readers]
        self.connection.publish(self._presence_topic, pack_announcement(self.node, ends), 1, True, None)

    def _expire(self) -> None:
        self.discovery.expire()
        self._expiring = self.loop.call_later(_EXPIRE_S, self._expire)
