"""The table of what is discovered, on the loop: endpoints, nodes, and the events of their coming and going."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from ropeway.graph.base import EndpointInfo, GraphEvent, NodeInfo, TopicInfo
from ropeway.graph.calls import ActionInfo, ProviderInfo, ServiceInfo
from ropeway.networks.dds.layouts import OLD
from ropeway.networks.dds.names import (
    Name,
    NameKind,
    action_of,
    action_of_feedback,
    action_type,
    demangle,
    feedback_of,
    goals_of,
    is_hidden,
    is_of_action,
)
from ropeway.networks.dds.nodes import OLD_GID_BYTES, NodeEntities
from ropeway.networks.dds.records import Discovered, EndpointRecord, Gone, Joined, NodesRecord
from ropeway.qos import QoS

__all__ = ["DdsDiscovery"]

# An endpoint is discovered a moment before the message that tells whose node it is; its event waits this long for it.
_NODE_GRACE_S: Final = 0.25
log = logging.getLogger("ropeway.dds")

_MAX_EARLY: Final = 64


@dataclass(slots=True)
class _Endpoint:
    record: EndpointRecord
    name: Name
    node: str = ""


@dataclass(slots=True)
class _Topic:
    """Endpoints of one ROS topic, by handle."""

    publishers: dict[int, _Endpoint] = field(default_factory=dict)
    subscriptions: dict[int, _Endpoint] = field(default_factory=dict)

    def of(self, kind: str) -> dict[int, _Endpoint]:
        return self.publishers if kind == "publisher" else self.subscriptions


@dataclass(slots=True)
class _Action:
    """Endpoints of one action, by their participant and node: each of these serves or uses it once."""

    types: dict[str, None] = field(default_factory=dict)
    servers: dict[tuple[bytes, str], _Endpoint] = field(default_factory=dict)
    clients: dict[tuple[bytes, str], _Endpoint] = field(default_factory=dict)

    def add(self, type: str, endpoint: _Endpoint, node: str, *, serves: bool) -> None:
        self.types[type] = None
        key = (endpoint.record.participant, node)
        (self.servers if serves else self.clients).setdefault(key, endpoint)


class DdsDiscovery:
    """Keeps what is discovered on the network.

    ``emit`` gets the events, others' only; ``changed`` the ROS topics whose publishers changed, once per batch;
    ``gid_bytes`` the sizes of gid that others write. ``foreign`` keeps topics that are not of ROS, under their DDS
    names.
    """

    def __init__(
        self,
        graph: str,
        gateway_id: str,
        emit: Callable[[GraphEvent], None],
        changed: Callable[[set[str]], None],
        gid_bytes: Callable[[set[int]], None],
        *,
        foreign: bool = False,
    ) -> None:
        self._graph, self._gateway_id, self._foreign = graph, gateway_id, foreign
        self._emit, self._changed, self._tell_gid_bytes = emit, changed, gid_bytes
        self._endpoints: dict[tuple[str, int], _Endpoint] = {}
        self._topics: dict[str, _Topic] = {}
        self._services: dict[str, _Topic] = {}  # by what carries the requests: who publishes them is a client
        self._participants: set[bytes] = set()
        self._early: dict[bytes, NodesRecord] = {}
        self._nodes: dict[bytes, NodesRecord] = {}
        self._node_of: dict[bytes, str] = {}
        self._nameless: dict[bytes, _Endpoint] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._twins: set[bytes] = set()  # participants with a node of our name, of whom the log has told

    def apply(self, batch: Iterable[Discovered]) -> None:
        """Take in what the thread found."""
        topics: set[str] = set()
        for item in batch:
            if isinstance(item, EndpointRecord):
                self._add(item, topics)
            elif isinstance(item, NodesRecord):
                self._tell_nodes(item)
            elif isinstance(item, Joined):
                self._participants.add(item.participant)
                if (early := self._early.pop(item.participant, None)) is not None:
                    self._set_nodes(early)
            elif item.kind == "participant":
                self._participants.discard(item.guid)
                self._set_nodes(NodesRecord(item.guid, (), 0, local=False))
            else:
                self._remove(item, topics)
        self._tell_named()
        if topics:
            self._changed(topics)

    def close(self) -> None:
        """Stop emitting events."""
        self._nameless.clear()
        if self._timer is not None:
            self._timer.cancel()

    # Queries ----------------------------------------------------------------------------------------------------

    def topics(self) -> dict[str, TopicInfo]:
        """Return every topic, with its endpoints; those that belong to actions stand under ``actions``."""
        return {
            name: self._topic_info(name, topic)
            for name, topic in sorted(self._topics.items())
            if not is_of_action(name)
        }

    def services(self) -> dict[str, ServiceInfo]:
        """Return every service, with its servers and clients, including those of actions."""
        return {name: self._service_info(name, service) for name, service in sorted(self._services.items())}

    def counts(self) -> tuple[int, int]:
        """See ``Graph.counts``."""
        topics = sum([not is_of_action(name) for name in self._topics])
        return topics, len({node.name for record in self._nodes.values() for node in record.nodes})

    def count_publishers(self, topic: str) -> tuple[int, int]:
        """See ``Graph.count_publishers``."""
        found = self._topics.get(topic)
        if found is None or is_of_action(topic):
            return 0, 0
        own = sum([endpoint.record.local for endpoint in found.publishers.values()])
        return len(found.publishers) - own, own

    def look_up(self, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None:
        """See ``Graph.look_up``."""
        if kind == "topic":
            topic = self._topics.get(name)
            return None if topic is None or is_of_action(name) else self._topic_info(name, topic)
        if kind == "service":
            service = self._services.get(name)
            return None if service is None else self._service_info(name, service)
        carriers = (self._services.get(goals_of(name)), self._topics.get(feedback_of(name)))
        endpoints = [
            e for found in carriers if found for e in (*found.publishers.values(), *found.subscriptions.values())
        ]
        return self._actions_of(endpoints).get(name)

    def types_of(self, kind: str, name: str) -> tuple[str, ...]:
        """Return the types that one topic, service or action has now."""
        if kind == "action":
            goals, feedback = self._services.get(goals_of(name)), self._topics.get(feedback_of(name))
            used = [*goals.subscriptions.values(), *goals.publishers.values()] if goals is not None else []
            used += [*feedback.publishers.values(), *feedback.subscriptions.values()] if feedback is not None else []
            return tuple(dict.fromkeys([action_type(endpoint.name.type) for endpoint in used]))
        if kind == "topic" and is_of_action(name):
            return ()
        found = (self._topics if kind == "topic" else self._services).get(name)
        if found is None:
            return ()
        first, second = found.publishers.values(), found.subscriptions.values()
        if kind == "service":
            first, second = second, first
        return tuple(dict.fromkeys([endpoint.name.type for endpoint in (*first, *second)]))

    def actions(self) -> dict[str, ActionInfo]:
        """Return every action: its servers and clients, and who else publishes or reads feedback."""
        return self._actions_of(self._endpoints.values())

    def _actions_of(self, endpoints: Iterable[_Endpoint]) -> dict[str, ActionInfo]:
        found: dict[str, _Action] = {}
        for endpoint in endpoints:
            name, reads = endpoint.name, endpoint.record.kind == "subscription"
            if endpoint.record.helper or not is_of_action(name.name):
                continue
            if name.kind is NameKind.REQUEST:
                action, serves = action_of(name.name, name.type), reads
            else:
                action, serves = action_of_feedback(name.name, name.type), not reads
            if action is not None and name.kind in (NameKind.REQUEST, NameKind.TOPIC):
                node = self.node_of(endpoint.record.guid)
                found.setdefault(action[0], _Action()).add(action[1], endpoint, node, serves=serves)
        return {
            name: ActionInfo(
                name,
                tuple(action.types),
                tuple(self._provider_info(e) for e in action.servers.values()),
                tuple(self._provider_info(e) for e in action.clients.values()),
            )
            for name, action in sorted(found.items())
        }

    def guids(self, prefix: bytes) -> list[bytes]:
        """Return the ROS endpoints whose GUIDs begin with ``prefix``."""
        return [e.record.guid for e in self._endpoints.values() if e.record.guid.startswith(prefix)]

    def node_of(self, guid: bytes) -> str:
        """Return the full name of the node that an endpoint belongs to, or ``""``."""
        return self._node_of.get(guid, "")

    def nodes(self) -> dict[str, NodeInfo]:
        """Return every node, with what it publishes, reads, serves and calls."""
        found: dict[str, list[NodeEntities]] = {}
        local: set[str] = set()
        for record in self._nodes.values():
            for node in record.nodes:
                found.setdefault(node.name, []).append(node)
                if record.local:
                    local.add(node.name)
        by_guid = {endpoint.record.guid: endpoint for endpoint in self._endpoints.values()}
        return {
            name: _node_info(name, entities, by_guid, local=name in local) for name, entities in sorted(found.items())
        }

    @property
    def settled(self) -> bool:
        """Whether the nodes of every participant are known (participants without ROS never announce any)."""
        return all(participant in self._nodes for participant in self._participants)

    def offered(self, topic: str, type: str) -> list[QoS]:
        """Return the profiles of all publishers of a topic except those of our own gateway."""
        known = self._topics.get(topic)
        if known is None:
            return []
        return [e.record.qos for e in known.publishers.values() if e.name.type == type and not self._is_own(e.record)]

    def signs(self, role: str, name: str, guid: bytes | None = None) -> set[str]:
        """See ``layouts.Signs``. Other gateways do not count: they understand every layout."""
        topic = (self._topics if role in ("publisher", "subscription") else self._services).get(name)
        if topic is None:
            return set()
        endpoints = topic.publishers if role in ("publisher", "client") else topic.subscriptions
        return {
            sign
            for record in (endpoint.record for endpoint in endpoints.values())
            if guid in (None, record.guid) and not (record.local or record.gateway or record.helper)
            if (sign := self._sign(record))
        }

    def _sign(self, record: EndpointRecord) -> str:
        nodes = self._nodes.get(record.participant)
        return OLD if nodes is not None and nodes.gid_bytes == OLD_GID_BYTES else record.type_hash

    def _topic_info(self, name: str, topic: _Topic) -> TopicInfo:
        publishers = tuple(self._endpoint_info(e) for e in topic.publishers.values())
        subscriptions = tuple(self._endpoint_info(e) for e in topic.subscriptions.values())
        types = tuple(dict.fromkeys(e.type for e in publishers + subscriptions))
        return TopicInfo(name, types, publishers, subscriptions)

    def _endpoint_info(self, endpoint: _Endpoint) -> EndpointInfo:
        record = endpoint.record
        return EndpointInfo(
            kind=record.kind,
            topic=endpoint.name.name,
            type=endpoint.name.type,
            qos=record.qos,
            gid=record.guid,
            node=self._node_of.get(record.guid, ""),
            type_hash=record.type_hash,
            gateway=record.gateway,
            local=record.local,
        )

    def _service_info(self, name: str, service: _Topic) -> ServiceInfo:
        servers, clients = service.subscriptions.values(), service.publishers.values()
        types = tuple(dict.fromkeys(endpoint.name.type for endpoint in (*servers, *clients)))
        return ServiceInfo(
            name, types, tuple(map(self._provider_info, servers)), tuple(map(self._provider_info, clients))
        )

    def _provider_info(self, endpoint: _Endpoint) -> ProviderInfo:
        record = endpoint.record
        return ProviderInfo(
            self._node_of.get(record.guid, ""), record.gateway, record.local, record.guid, record.since_ns
        )

    def _is_own(self, record: EndpointRecord) -> bool:
        return record.local or (bool(self._gateway_id) and record.gateway == self._gateway_id)

    # Changes ----------------------------------------------------------------------------------------------------

    def _add(self, record: EndpointRecord, topics: set[str]) -> None:
        name = demangle(record.dds_topic, record.dds_type)
        if name.kind is NameKind.FOREIGN and not self._foreign:
            return
        key = (record.kind, record.handle)
        known = self._endpoints.get(key)
        if known is not None and known.record == record:
            return
        endpoint = self._endpoints[key] = _Endpoint(record, name)
        if name.kind in (NameKind.TOPIC, NameKind.FOREIGN):
            self._topics.setdefault(name.name, _Topic()).of(record.kind)[record.handle] = endpoint
            if record.kind == "publisher":
                topics.add(name.name)
        elif name.kind is NameKind.REQUEST and not record.helper:
            self._services.setdefault(name.name, _Topic()).of(record.kind)[record.handle] = endpoint
        if known is None and not record.local and not record.helper:
            self._nameless[record.guid] = endpoint

    def _remove(self, gone: Gone, topics: set[str]) -> None:
        endpoint = self._endpoints.pop((gone.kind, gone.handle), None)
        if endpoint is None:
            return
        name = endpoint.name
        table = self._services if name.kind is NameKind.REQUEST else self._topics
        topic = table.get(name.name) if name.kind is not NameKind.REPLY else None
        if topic is not None:
            topic.of(gone.kind).pop(gone.handle, None)
            if not topic.publishers and not topic.subscriptions:
                del table[name.name]
            if gone.kind == "publisher" and table is self._topics:
                topics.add(name.name)
        if self._nameless.pop(gone.guid, None) is not None:
            self._tell(endpoint, True)
        self._tell(endpoint, False)

    def _tell_named(self) -> None:
        """Tell of the endpoints whose nodes are known, and of the others when they have waited long enough."""
        waiting = self._nameless
        for guid in [guid for guid in waiting if guid in self._node_of]:
            self._tell(waiting.pop(guid), True)
        if waiting and self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(_NODE_GRACE_S, self._tell_rest, list(waiting))

    def _tell_rest(self, guids: list[bytes]) -> None:
        self._timer = None
        for guid in guids:
            endpoint = self._nameless.pop(guid, None)
            if endpoint is not None:
                self._tell(endpoint, True)
        self._tell_named()

    def _tell(self, endpoint: _Endpoint, discovered: bool) -> None:
        record, name = endpoint.record, endpoint.name
        if record.local or record.helper:
            return
        node = endpoint.node = self._node_of.get(record.guid) or endpoint.node
        if name.kind is NameKind.REQUEST:
            if record.kind != "subscription":
                return
            action = action_of(name.name, name.type)
            if action is not None:
                self._emit(GraphEvent(discovered, "action", *action, node, self._graph))
            elif not is_hidden(name.name):
                self._emit(GraphEvent(discovered, "service", name.name, name.type, node, self._graph))
        elif name.kind is not NameKind.REPLY and not is_hidden(name.name):
            self._emit(GraphEvent(discovered, record.kind, name.name, name.type, node, self._graph))

    def _tell_nodes(self, record: NodesRecord) -> None:
        """Take nodes of participants that are there; what comes before or after them must not outlive them."""
        if record.local or record.participant in self._participants:
            self._set_nodes(record)
            return
        self._early[record.participant] = record
        if len(self._early) > _MAX_EARLY:
            del self._early[next(iter(self._early))]

    def _set_nodes(self, record: NodesRecord) -> None:
        previous = self._nodes.pop(record.participant, None)
        before = previous.nodes if previous is not None else ()
        if record.nodes:
            self._nodes[record.participant] = record
        for guid in _guids(before):
            self._node_of.pop(guid, None)
        for node in record.nodes:
            for guid in _guids((node,)):
                self._node_of[guid] = node.name
        self._warn_of_twins(record)
        if record.local:
            return
        old, new = {n.name for n in before}, {n.name for n in record.nodes}
        for name in sorted(new - old):
            self._emit(GraphEvent(True, "node", name, graph=self._graph))
        for name in sorted(old - new):
            self._emit(GraphEvent(False, "node", name, graph=self._graph))
        self._tell_gid_bytes({r.gid_bytes for r in self._nodes.values() if not r.local})

    def _warn_of_twins(self, record: NodesRecord) -> None:
        """Say that another participant has a node of our name: who is called by that name is left to chance."""
        others = [other for other in self._nodes.values() if other.local != record.local]
        if not record.local and not record.nodes:
            self._twins.discard(record.participant)
        for other in others:
            theirs = record if other.local else other
            if shared := {node.name for node in record.nodes} & {node.name for node in other.nodes}:
                if theirs.participant in self._twins:
                    continue
                self._twins.add(theirs.participant)
                names = ", ".join(sorted(shared))
                log.warning(
                    "%s: another participant is called %s, too; give one of the two another name", self._graph, names
                )


def _guids(nodes: tuple[NodeEntities, ...]) -> Iterator[bytes]:
    for node in nodes:
        yield from node.readers
        yield from node.writers


def _node_info(name: str, entities: list[NodeEntities], by_guid: dict[bytes, _Endpoint], *, local: bool) -> NodeInfo:
    publishers: dict[tuple[str, str], None] = {}
    subscriptions: dict[tuple[str, str], None] = {}
    services: dict[tuple[str, str], None] = {}
    clients: dict[tuple[str, str], None] = {}
    for node in entities:
        for guid in _guids((node,)):
            endpoint = by_guid.get(guid)
            if endpoint is None:
                continue
            entry = (endpoint.name.name, endpoint.name.type)
            writes = endpoint.record.kind == "publisher"
            if endpoint.name.kind is NameKind.REQUEST:
                (clients if writes else services)[entry] = None
            elif endpoint.name.kind is not NameKind.REPLY:
                (publishers if writes else subscriptions)[entry] = None
    return NodeInfo(
        name,
        tuple(sorted(publishers)),
        tuple(sorted(subscriptions)),
        tuple(sorted(services)),
        tuple(sorted(clients)),
        local=local,
    )
