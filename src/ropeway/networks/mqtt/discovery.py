"""Knows what there is at a broker: what other gateways announce, and topics on which a message was seen."""

from __future__ import annotations

import hashlib
import time
from collections import Counter, OrderedDict
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from ropeway.errors import InvalidName
from ropeway.graph.base import EndpointInfo, GraphEvent, NodeInfo, Undelivered
from ropeway.limits import MQTT_PRESENCES, MQTT_TOPIC_AGE_S, MQTT_TOPICS
from ropeway.networks.mqtt.maps import BYTES, STRING, MqttMaps
from ropeway.networks.mqtt.names import is_pattern
from ropeway.networks.mqtt.presence import Announced, Announcement
from ropeway.networks.mqtt.wire import Received
from ropeway.qos import DEFAULT, LATCHED, QoS

__all__ = ["UNLISTED", "MqttDiscovery"]

UNLISTED: Final = "(topics of the broker)"
"""The name under which what cannot be listed is counted."""

_LOOKED_AT_BYTES: Final = 4096  # of a payload, to tell a text from bytes


class _SeenTopic:
    """A topic on which a message was seen."""

    __slots__ = ("at_s", "info")

    def __init__(self, info: EndpointInfo | None, at_s: float) -> None:
        self.info, self.at_s = info, at_s


class MqttDiscovery:
    """The endpoints at a broker, by their ROS names; ``emit`` is told what comes and goes."""

    def __init__(
        self,
        graph: str,
        maps: MqttMaps,
        emit: Callable[[GraphEvent], None],
        drops: Counter[tuple[str, Undelivered]],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._graph, self._maps, self._emit, self._drops, self._clock = graph, maps, emit, drops, clock
        self._gateways: dict[str, tuple[Announcement, dict[Announced, EndpointInfo]]] = {}
        self._seen: OrderedDict[str, _SeenTopic] = OrderedDict()
        self._announced: Counter[str] = Counter()  # topics of the broker, by who announces to publish them
        self._by_name: dict[str, dict[object, EndpointInfo]] = {}

    # ── what there is ──────────────────────────────────────────────────────────────────────────────────────────

    def names(self) -> set[str]:
        """Return the ROS names of all topics."""
        return set(self._by_name)

    def of(self, name: str) -> list[EndpointInfo]:
        """Return the endpoints of a ROS topic."""
        return list(self._by_name.get(name, {}).values())

    def offered(self, name: str) -> list[QoS]:
        """Return the profiles of those who publish a ROS topic."""
        return [info.qos for info in self._by_name.get(name, {}).values() if info.kind == "publisher"]

    def nodes(self) -> dict[str, NodeInfo]:
        """Return the gateways that announce something."""
        found: dict[str, NodeInfo] = {}
        for announcement, infos in self._gateways.values():
            ends = infos.values()
            publishers = tuple((end.topic, end.type) for end in ends if end.kind == "publisher")
            subscriptions = tuple((end.topic, end.type) for end in ends if end.kind == "subscription")
            before = found.get(announcement.node, NodeInfo(announcement.node))
            found[announcement.node] = replace(
                before,
                publishers=before.publishers + publishers,
                subscriptions=before.subscriptions + subscriptions,
            )
        return found

    # ── what is learnt ─────────────────────────────────────────────────────────────────────────────────────────

    def announce(self, id: str, announcement: Announcement | None) -> None:
        """Take what a gateway tells, or ``None`` when it is gone."""
        before, old = self._gateways.pop(id, (None, {}))
        if announcement is None:
            for end, info in old.items():
                self._lose(id, end, info)
        else:
            if before is None and len(self._gateways) >= MQTT_PRESENCES:
                self._drops[UNLISTED, Undelivered.BACKLOG] += 1
                return
            new = self._infos(id, announcement)
            self._gateways[id] = (announcement, new)
            for end, info in old.items():
                if end not in new:
                    self._lose(id, end, info)
            for end, info in new.items():
                if old.get(end) != info:
                    self._find(id, end, info)
        if (before is None) != (announcement is None):
            node = announcement.node if announcement is not None else before.node if before is not None else ""
            self._emit(GraphEvent(announcement is not None, "node", node, graph=self._graph))

    def see(self, message: Received) -> None:
        """Take note of a message on a topic: a retained one makes it latched, an empty one takes the value away."""
        topic, seen = message.topic, self._seen
        if not message.payload:
            self.forget(topic)
            return
        known = seen.get(topic)
        now_s = self._clock()
        if known is not None and (not message.retained or known.info is None or known.info.qos.transient_local):
            known.at_s = now_s
            seen.move_to_end(topic)
            return
        if topic in self._announced or topic.startswith("$"):
            return
        self.forget(topic)
        info = self._described(message)
        seen[topic] = _SeenTopic(info, now_s)
        if info is not None:
            self._put(info.topic, ("seen", topic), info)
        else:
            self._drops[UNLISTED, Undelivered.DECODE] += 1
        while len(seen) > MQTT_TOPICS:
            self.forget(next(iter(seen)))
            self._drops[UNLISTED, Undelivered.BACKLOG] += 1

    def forget(self, topic: str) -> None:
        """Forget a topic that was seen."""
        known = self._seen.pop(topic, None)
        if known is not None and known.info is not None:
            self._take(known.info.topic, ("seen", topic), known.info)

    def expire(self) -> None:
        """Forget topics on which nothing has come for long."""
        oldest_s = self._clock() - MQTT_TOPIC_AGE_S
        for topic, known in list(self._seen.items()):
            if known.at_s > oldest_s:
                break
            if known.info is None or not known.info.qos.transient_local:  # a value that the broker keeps is there
                self.forget(topic)

    def clear(self) -> None:
        """Forget everything: the broker is gone."""
        for id in list(self._gateways):
            self.announce(id, None)
        for topic in list(self._seen):
            self.forget(topic)

    # ── inside ─────────────────────────────────────────────────────────────────────────────────────────────────

    def _infos(self, id: str, announcement: Announcement) -> dict[Announced, EndpointInfo]:
        found: dict[Announced, EndpointInfo] = {}
        for end in announcement.endpoints:
            if is_pattern(end.topic):
                continue
            try:
                name = self._maps.name_of(end.topic)
            except InvalidName:
                self._drops[UNLISTED, Undelivered.DECODE] += 1
                continue
            gid = hashlib.sha256(f"{id} {end.kind} {end.topic}".encode(errors="surrogatepass")).digest()[:16]
            found[end] = EndpointInfo(end.kind, name, end.type, end.qos, gid=gid, node=announcement.node)
        return found

    def _described(self, message: Received) -> EndpointInfo | None:
        map = self._maps.of(message.topic)
        try:
            name = self._maps.name_of(message.topic)
        except InvalidName:
            return None
        type = map.type if map is not None else message.type or _likely_type(message.payload)
        latched = message.retained or (map is not None and map.latched)
        return EndpointInfo("publisher", name, type, LATCHED if latched else DEFAULT, gid=message.origin)

    def _find(self, id: str, end: Announced, info: EndpointInfo) -> None:
        if end.kind == "publisher":
            self._announced[end.topic] += 1
            self.forget(end.topic)
        self._put(info.topic, (id, end.kind, end.topic), info)

    def _lose(self, id: str, end: Announced, info: EndpointInfo) -> None:
        if end.kind == "publisher":
            self._announced[end.topic] -= 1
            if not self._announced[end.topic]:
                del self._announced[end.topic]
        self._take(info.topic, (id, end.kind, end.topic), info)

    def _put(self, name: str, key: object, info: EndpointInfo) -> None:
        self._by_name.setdefault(name, {})[key] = info
        self._emit(GraphEvent(True, info.kind, name, info.type, info.node, self._graph))

    def _take(self, name: str, key: object, info: EndpointInfo) -> None:
        ends = self._by_name.get(name, {})
        if ends.get(key) is info:
            del ends[key]
            if not ends:
                del self._by_name[name]
        self._emit(GraphEvent(False, info.kind, name, info.type, info.node, self._graph))


def _likely_type(payload: bytes) -> str:
    """Return the type of a payload that nobody tells: a text, or bytes."""
    head = payload[:_LOOKED_AT_BYTES]
    try:
        head.decode()
    except UnicodeDecodeError as error:
        if len(payload) <= _LOOKED_AT_BYTES or error.start < _LOOKED_AT_BYTES - 4:
            return BYTES
    return BYTES if b"\0" in head else STRING
