"""The ``iort`` graph: systems and topics of robots of any make appear as ``/SYSTEM/TOPIC``.

Values are text on one side and CDR on the other; ``maps`` says how they are converted. A topic without a map is a
``std_msgs/msg/String`` if nodes publish it, and JSON if a graph does.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
import re
from typing import Final

from ropeway.errors import InvalidTypeName, TypeConflict
from ropeway.fault_log import FaultLog
from ropeway.graph.base import (
    NO_HINTS,
    Delivery,
    EndpointInfo,
    GraphEvent,
    NodeInfo,
    SampleCallback,
    TopicInfo,
    new_origin,
    resolve_name,
)
from ropeway.graph.deduplication import Seen
from ropeway.graph.topics_only import TopicsOnlyGraph
from ropeway.networks.iort.links import Link
from ropeway.networks.iort.maps import Maps, TopicMap, ros_name
from ropeway.networks.iort.parts import IortPublisher, IortSubscription, NodeTopic
from ropeway.networks.iort.space import MemberEndpoint, is_pattern
from ropeway.qos import DEFAULT, LATCHED, QoS
from ropeway.store import Entry
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name
from ropeway.types.untrusted import json_value

__all__ = ["IortGraph"]

log = logging.getLogger("ropeway.iort")

STRING: Final = "std_msgs/msg/String"
_ODD: Final = re.compile(r"[^A-Za-z0-9_]")
_HAD_LIMIT: Final = 4096


class IortGraph(TopicsOnlyGraph):
    """Topics of the robots at one server, which ``link`` reaches."""

    kind = "iort"
    no_calls = "has topics only: IoRT nodes know neither services nor actions"

    def __init__(
        self, link: Link, *, name: str, maps: Maps | None = None, registry: TypeRegistry | None = None
    ) -> None:
        super().__init__(name)
        self.link = link
        self.maps = maps or Maps()
        self.registry = registry or TypeRegistry()
        self.fault_log = FaultLog(name)
        self.origin = new_origin()
        self.loop: asyncio.AbstractEventLoop
        self.publishers: list[IortPublisher] = []
        self.subscriptions: list[IortSubscription] = []
        self._feeds: dict[tuple[str, str], NodeTopic] = {}
        self._endpoints: dict[tuple[str, str, str, str], MemberEndpoint] = {}
        self._infos: dict[MemberEndpoint, EndpointInfo] = {}  # what has been made of them
        self._had: dict[tuple[str, str], Seen] = {}

    async def _join(self) -> None:
        self.loop = asyncio.get_running_loop()
        await self.link.open(self._value, self._event, self._lost)

    async def _close_parts(self) -> None:
        for publisher in list(self.publishers):
            await publisher.close()
        for subscription in list(self.subscriptions):
            await subscription.close()

    async def _leave(self) -> None:
        await self.link.close()
        self._endpoints.clear()
        self._infos.clear()

    # ── parts ──────────────────────────────────────────────────────────────────────────────────────────────────

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> IortPublisher:
        """Publish ``topic`` to the nodes behind it. Raises ``TypeConflict`` where the map has another type."""
        topic, type = self._check(topic, type)
        publisher = IortPublisher(self, topic, type, qos or DEFAULT)
        self._check_types(topic, type, [map.type for _, _, _, map in publisher.targets if map is not None])
        self.publishers.append(publisher)
        for system, name, _, _ in publisher.targets:
            await self.link.advertise(system, name, type, json.dumps(publisher.qos.to_json()))
        return publisher

    async def create_subscription(
        self,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> IortSubscription:
        """Read what the nodes behind ``topic`` publish. Raises ``TypeConflict`` where the map has another type."""
        topic, type = self._check(topic, type)
        subscription = IortSubscription(self, topic, type, qos, callback)
        sources = self.resolved(topic, "in")
        self._check_types(topic, type, [map.type for _, _, map in sources if map is not None])
        self.subscriptions.append(subscription)
        subscription.readopt()
        for system, name, map in sources:
            form = map.make_form(self.registry) if map is not None else None
            feed = self._feeds.get((system, name))
            if feed is None:
                feed = self._feeds[system, name] = NodeTopic(system, name)
                subscription.join(feed, form)
                text = json.dumps(subscription.qos.to_json())
                await self.link.subscribe(system, name, type, text)
            else:
                subscription.join(feed, form)
        return subscription

    # ── what is there ──────────────────────────────────────────────────────────────────────────────────────────

    def topics(self) -> dict[str, TopicInfo]:
        """Return every topic that a node publishes or reads, by its ROS name."""
        found: dict[str, tuple[list[EndpointInfo], list[EndpointInfo]]] = {}
        for endpoint in self._endpoints.values():
            if is_pattern(endpoint.system) or is_pattern(endpoint.topic):
                continue
            info = self._info(endpoint)
            found.setdefault(info.topic, ([], []))[info.kind != "publisher"].append(info)
        for publisher in self.publishers:
            info = EndpointInfo("publisher", publisher.topic, publisher.type, publisher.qos, node="", local=True)
            found.setdefault(publisher.topic, ([], []))[0].append(info)
        for subscription in self.subscriptions:
            info = EndpointInfo(
                "subscription", subscription.topic, subscription.type, subscription.qos, node="", local=True
            )
            found.setdefault(subscription.topic, ([], []))[1].append(info)
        return {
            name: TopicInfo(name, tuple(dict.fromkeys(e.type for e in pubs + subs)), tuple(pubs), tuple(subs))
            for name, (pubs, subs) in sorted(found.items())
        }

    def nodes(self) -> dict[str, NodeInfo]:
        """Return the nodes that publish or read something."""
        ends: dict[str, tuple[list[tuple[str, str]], list[tuple[str, str]]]] = {}
        for endpoint in self._endpoints.values():
            info = self._info(endpoint)
            entry = ends.setdefault(info.node, ([], []))
            entry[info.kind != "publisher"].append((info.topic, info.type))
        return {node: NodeInfo(node, tuple(pubs), tuple(subs)) for node, (pubs, subs) in sorted(ends.items())}

    def offered(self, topic: str) -> list[QoS]:
        """Return the profiles of others that publish a topic."""
        known = [self._info(e) for e in self._endpoints.values() if e.kind == "publisher"]
        return [info.qos for info in known if info.topic == topic]

    # ── inside ─────────────────────────────────────────────────────────────────────────────────────────────────

    def had(self, system: str, topic: str) -> Seen:
        """Return the identifiers of samples that came from a topic of nodes, so that they are not sent back there."""
        found = self._had.get((system, topic))
        if found is None:
            if len(self._had) >= _HAD_LIMIT:
                self._had.clear()
            found = self._had[system, topic] = Seen()
        return found

    async def forget(self, subscription: IortSubscription) -> None:
        """Release what belongs to a closed subscription."""
        if subscription in self.subscriptions:
            self.subscriptions.remove(subscription)
        for key, feed in list(self._feeds.items()):
            feed.readers = [(s, form) for s, form in feed.readers if s is not subscription]
            if not feed.readers:
                del self._feeds[key]
                if self._is_open:
                    await self.link.unsubscribe(*key)

    async def withdraw(self, publisher: IortPublisher) -> None:
        """Remove a closed publisher."""
        if publisher in self.publishers:
            self.publishers.remove(publisher)
        for system, topic, _, _ in publisher.targets:
            others = any((system, topic) == (s, t) for p in self.publishers for s, t, _, _ in p.targets)
            if not others and self._is_open:
                await self.link.withdraw(system, topic)

    def resolved(self, topic: str, direction: str) -> list[tuple[str, str, TopicMap | None]]:
        """Return the topics of nodes behind a ROS name, ``in`` or ``out``.

        The maps know best; else a node's topic whose name ROS would not allow may be meant.
        """
        found = self.maps.at(topic, direction)
        if len(found) == 1 and (found[0][2] is None or found[0][2].is_pattern):
            for endpoint in self._endpoints.values():
                if self._info(endpoint).topic == topic:
                    return [(endpoint.system, endpoint.topic, self.maps.of(endpoint.system, endpoint.topic))]
        return found

    def _check(self, topic: str, type: str) -> tuple[str, str]:
        self._check_open()
        if not type:
            raise TypeConflict(topic, "a type", "none")
        return resolve_name(topic), canonical_name(type, "msg")

    def _check_types(self, topic: str, type: str, mapped: list[str]) -> None:
        for one in mapped:
            if one != type:
                raise TypeConflict(topic, one, type)

    def _info(self, endpoint: MemberEndpoint) -> EndpointInfo:
        found = self._infos.get(endpoint)
        if found is None:
            found = self._infos[endpoint] = self._described(endpoint)
        return found

    def _described(self, endpoint: MemberEndpoint) -> EndpointInfo:
        map = self.maps.of(endpoint.system, endpoint.topic)
        try:
            type = map.type if map is not None else canonical_name(endpoint.type, "msg") if endpoint.type else STRING
        except InvalidTypeName:
            type = STRING
        name = map.ros_name(endpoint.system, endpoint.topic) if map else ros_name(endpoint.system, endpoint.topic)
        return EndpointInfo(
            endpoint.kind,
            name,
            type,
            _profile(endpoint.qos, latched=map is not None and map.latched),
            gid=hashlib.sha256(f"{endpoint.id}/{endpoint.node}/{name}".encode()).digest()[:16],
            node=_node_name(endpoint.node),
        )

    def _event(self, endpoint: MemberEndpoint, there: bool) -> None:
        key = (endpoint.id, endpoint.kind, endpoint.system, endpoint.topic)
        before = self._endpoints.pop(key, None)
        if there:
            self._endpoints[key] = endpoint
        elif before is None:
            return
        if before is not None and before != endpoint:
            self._infos.pop(before, None)
        if is_pattern(endpoint.system) or is_pattern(endpoint.topic):
            return
        info = self._infos.get(endpoint) or self._described(endpoint)  # which is kept once somebody asks
        if not there:
            self._infos.pop(endpoint, None)
        if endpoint.kind == "publisher":
            for subscription in list(self.subscriptions):
                if subscription.topic == info.topic:
                    subscription.readopt()
        self._changes.emit(GraphEvent(there, info.kind, info.topic, info.type, info.node, self.name))

    def _lost(self) -> None:
        for endpoint in list(self._endpoints.values()):
            self._event(endpoint, False)

    def _value(self, entry: Entry, latest: bool) -> None:
        feed = self._feeds.get(entry.key)
        if feed is not None and not self._is_own(entry):
            feed.take(entry, latest)

    def _is_own(self, entry: Entry) -> bool:
        return entry.origin.endswith(self.own_mark)

    @property
    def own_mark(self) -> str:
        """The end of the origin of every value that we publish."""
        return f"+{self.origin.hex()[:16]}"


def _profile(text: str, *, latched: bool) -> QoS:
    """Return the profile of an advertisement. Robots give none: their last value is not repeated, unless the map has it
    latched. Robots say nothing: what they said last is not said again, unless the map has it latched.

    A command that is old must not move a robot whose driver starts late.
    """
    if text:
        try:
            return QoS.parse(json_value(text))
        except (ValueError, TypeError):
            pass
    return LATCHED if latched else DEFAULT


def _node_name(node: str) -> str:
    name = _ODD.sub("_", node) or "node"
    return f"/_{name}" if name[0].isdigit() else f"/{name}"
