"""Keeps what is discovered, on the loop: the newest snapshot of the network, and the events between two."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator

from ropeway.graph.actions import action_of_service
from ropeway.graph.base import EndpointInfo, GraphEvent, NodeInfo, TopicInfo
from ropeway.graph.calls import ServiceInfo
from ropeway.networks.dds.names import is_hidden
from ropeway.networks.ros2.snapshot import Ros2Snapshot, is_inner
from ropeway.qos import QoS

__all__ = ["Ros2Discovery"]

log = logging.getLogger("ropeway.ros2")

_Thing = tuple[str, str, str, object]  # kind, name, type, and what tells two of them apart


class Ros2Discovery:
    """Compares snapshots of the network: ``emit`` gets the events, others' only; ``changed`` the topics whose
    publishers changed.
    """

    def __init__(
        self, graph: str, gateway_id: str, emit: Callable[[GraphEvent], None], changed: Callable[[set[str]], None]
    ) -> None:
        self._graph, self._gateway_id = graph, gateway_id
        self._emit, self._changed = emit, changed
        self._picture = Ros2Snapshot()
        self._told: dict[_Thing, str] = {}  # and the node that it was told with
        self._nameless: set[_Thing] = set()
        self._offers: dict[str, frozenset[tuple[bytes, QoS]]] = {}
        self._warned: set[str] = set()
        self.own_gids: frozenset[bytes] = frozenset()  # publishers of other processes of our gateway
        self.settled = False

    def topics(self) -> dict[str, TopicInfo]:
        """Return every topic; those that belong to actions stand under the actions."""
        return {name: topic for name, topic in self._picture.topics.items() if _has_ends(topic) and not is_inner(name)}

    def services(self) -> dict[str, ServiceInfo]:
        """Return every service."""
        return self._picture.services

    def nodes(self) -> dict[str, NodeInfo]:
        """Return every node."""
        return self._picture.nodes

    def publishers(self, topic: str, type: str) -> list[EndpointInfo]:
        """Return the publishers of others, excluding those of our own gateway."""
        return [end for end in self.all_publishers(topic, type) if not self.is_own(end)]

    def all_publishers(self, topic: str, type: str) -> list[EndpointInfo]:
        """Return all publishers of a topic, ours included."""
        known = self._picture.topics.get(topic)
        return [e for e in known.publishers if e.type == type] if known is not None else []

    def subscriptions(self, topic: str, type: str) -> list[EndpointInfo]:
        """Return all subscriptions of a topic, ours included."""
        known = self._picture.topics.get(topic)
        return [e for e in known.subscriptions if e.type == type] if known is not None else []

    def is_own(self, end: EndpointInfo) -> bool:
        """Return whether the endpoint belongs to this graph, or to another process of the same gateway."""
        return end.local or (bool(self._gateway_id) and end.gateway == self._gateway_id)

    def apply(self, picture: Ros2Snapshot) -> None:
        """Take in a new picture."""
        self._picture = picture
        self.settled = True
        offers = {
            name: frozenset((e.gid, e.qos) for e in topic.publishers if not e.local)
            for name, topic in picture.topics.items()
        }
        self.own_gids = frozenset(
            e.gid for t in picture.topics.values() for e in t.publishers if self.is_own(e) and not e.local
        )
        before, self._offers = self._offers, offers
        nothing: frozenset[tuple[bytes, QoS]] = frozenset()
        changed = {n for n in before.keys() | offers.keys() if before.get(n, nothing) != offers.get(n, nothing)}
        if changed:
            self._changed(changed)
        self._tell(picture)
        self._warn(picture)

    def _tell(self, picture: Ros2Snapshot) -> None:
        now: dict[_Thing, str] = {}
        nameless: set[_Thing] = set()
        for thing, node in _things(picture):
            if not node and thing not in self._told and thing not in self._nameless:
                nameless.add(thing)  # its node is told a moment later
                self.settled = False
                continue
            now[thing] = node or self._told.get(thing, "")
        told, self._told, self._nameless = self._told, now, nameless
        for thing in told.keys() - now.keys():
            self._say(False, thing, told[thing])
        for thing in now.keys() - told.keys():
            self._say(True, thing, now[thing])

    def _say(self, discovered: bool, thing: _Thing, node: str) -> None:
        kind, name, type, _ = thing
        self._emit(GraphEvent(discovered, kind, name, type, "" if kind == "node" else node, self._graph))

    def _warn(self, picture: Ros2Snapshot) -> None:
        for gateway in picture.gateways - self._warned:
            self._warned.add(gateway)
            log.warning(
                "%s: gateway %s is on this network, too; rclpy cannot tell which of its messages came from here, "
                "so do not forward one topic both ways through both (graphs of the kind dds can)",
                self._graph,
                gateway,
            )


def _has_ends(topic: TopicInfo) -> bool:
    return bool(topic.publishers or topic.subscriptions)


def _things(picture: Ros2Snapshot) -> Iterator[tuple[_Thing, str]]:
    """Yield everything of others that events are emitted for, with its node."""
    for topic in picture.topics.values():
        if is_hidden(topic.name):
            continue
        for end in topic.publishers + topic.subscriptions:
            if not end.local:
                yield (end.kind, end.topic, end.type, end.gid), end.node
    for node in picture.nodes.values():
        if not node.local:
            yield ("node", node.name, "", None), node.name
    for service in picture.services.values():
        action = action_of_service(service.name, service.type)
        if action is None and is_hidden(service.name):
            continue
        kind, name, type = ("action", *action) if action is not None else ("service", service.name, service.type)
        for server in service.servers:
            if not server.local:
                yield (kind, name, type, server.node), server.node
