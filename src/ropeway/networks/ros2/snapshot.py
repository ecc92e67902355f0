"""Takes a snapshot of the network, as rclpy shows it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

from ropeway.graph.base import EndpointInfo, NodeInfo, TopicInfo
from ropeway.graph.calls import ProviderInfo, ServiceInfo
from ropeway.networks.ros2.profiles import from_rclpy
from ropeway.networks.ros2.rcl import GID_BYTES

__all__ = ["MARK_TYPE", "Marks", "Ros2Snapshot", "is_inner", "mark_topic", "take_picture"]

MARK_TYPE: Final = "builtin_interfaces/msg/Time"
_MARK: Final = "/_ropeway/"
_INNER: Final = "/_action/"
_UNKNOWN: Final = "_NODE_NAME_UNKNOWN_"
_GUID_PREFIX_BYTES: Final = 12
_WITHOUT_GUIDS: Final = ("rmw_zenoh_cpp",)


def mark_topic(gateway_id: str, instance: str) -> str:
    """Return the name of a topic that nobody reads, which says which graph of which gateway its participant
    belongs to.
    """
    gateway = f"g{gateway_id.encode().hex()}/" if gateway_id else ""
    return f"{_MARK}{gateway}i{instance}"


def is_inner(name: str) -> bool:
    """Return whether the topic is part of something else: of an action, or one of our own marks."""
    return _INNER in name or name.startswith(_MARK)


@dataclass(frozen=True, slots=True)
class Marks:
    """Identifies participants by the marks of their graphs. ``own`` is our instance's name, ``node`` our node's."""

    own: str
    node: str
    gateway_id: str
    by_node: bool  # the gids of this middleware do not tell participants apart

    @classmethod
    def of(cls, own: str, node: str, gateway_id: str, rmw: str) -> Marks:
        """Make the marks for a graph on the middleware ``rmw``."""
        return cls(own, node, gateway_id, rmw in _WITHOUT_GUIDS)

    def participant(self, gid: bytes, node: str) -> bytes:
        """Return what names a participant."""
        return node.encode() if self.by_node else gid[:_GUID_PREFIX_BYTES]


@dataclass(frozen=True, slots=True)
class Ros2Snapshot:
    """The state of the whole network at one moment. ``topics`` has those that are parts of actions, too, but no marks
    of ours.
    """

    topics: dict[str, TopicInfo] = field(default_factory=dict)
    services: dict[str, ServiceInfo] = field(default_factory=dict)
    nodes: dict[str, NodeInfo] = field(default_factory=dict)
    gateways: frozenset[str] = frozenset()  # the ids of others


def take_picture(node: Any, marks: Marks) -> Ros2Snapshot:
    """Ask rclpy for everything; takes some milliseconds on a large network."""
    listed = node.get_topic_names_and_types()
    locals_, gateways = _read_marks(node, marks, [name for name, _ in listed if name.startswith(_MARK)])
    topics: dict[str, TopicInfo] = {}
    publishes: dict[str, list[tuple[str, str]]] = {}
    subscribes: dict[str, list[tuple[str, str]]] = {}
    for name, types in listed:
        if name.startswith(_MARK):
            continue
        ends: dict[str, tuple[EndpointInfo, ...]] = {}
        for kind, found, per_node in (
            ("publisher", node.get_publishers_info_by_topic(name), publishes),
            ("subscription", node.get_subscriptions_info_by_topic(name), subscribes),
        ):
            ends[kind] = tuple(_endpoint(kind, name, end, marks, locals_, gateways) for end in found)
            for end in ends[kind]:
                per_node.setdefault(end.node, []).append((name, end.type))
        both = ends["publisher"] + ends["subscription"]
        known = tuple(dict.fromkeys(end.type for end in both))
        topics[name] = TopicInfo(name, known or tuple(types), ends["publisher"], ends["subscription"])
    nodes, services = _read_nodes(node, marks, publishes, subscribes)
    others = frozenset(gateways.values()) - {"", marks.gateway_id}
    return Ros2Snapshot(topics, services, nodes, others)


def _read_marks(node: Any, marks: Marks, names: Iterable[str]) -> tuple[set[bytes], dict[bytes, str]]:
    """Return the participants that are ours, and the gateways of the others."""
    mine: set[bytes] = set()
    gateways: dict[bytes, str] = {}
    for name in names:
        gateway, _, instance = name.removeprefix(_MARK).rpartition("/")
        id = ""
        if gateway:
            with contextlib.suppress(ValueError):
                id = bytes.fromhex(gateway[1:]).decode("utf-8", "replace")
        for end in node.get_publishers_info_by_topic(name):
            participant = marks.participant(_gid(end), _node_name(end.node_namespace, end.node_name))
            gateways[participant] = id
            if instance == f"i{marks.own}":
                mine.add(participant)
    return mine, gateways


def _endpoint(
    kind: str, topic: str, end: Any, marks: Marks, locals_: set[bytes], gateways: dict[bytes, str]
) -> EndpointInfo:
    gid, node = _gid(end), _node_name(end.node_namespace, end.node_name)
    participant = marks.participant(gid, node)
    return EndpointInfo(
        kind=kind,
        topic=topic,
        type=end.topic_type,
        qos=from_rclpy(end.qos_profile),
        gid=gid,
        node=node,
        type_hash=_type_hash(end),
        gateway=gateways.get(participant, ""),
        local=participant in locals_,
    )


def _read_nodes(
    node: Any,
    marks: Marks,
    publishes: dict[str, list[tuple[str, str]]],
    subscribes: dict[str, list[tuple[str, str]]],
) -> tuple[dict[str, NodeInfo], dict[str, ServiceInfo]]:
    from rclpy.node import NodeNameNonExistentError

    nodes: dict[str, NodeInfo] = {}
    types_of = {name: tuple(types) for name, types in node.get_service_names_and_types()}
    ends: dict[str, tuple[list[ProviderInfo], list[ProviderInfo]]] = {name: ([], []) for name in types_of}
    for name, namespace in node.get_node_names_and_namespaces():
        full = _node_name(namespace, name)
        if not full or full in nodes:
            continue
        found: list[list[tuple[str, str]]] = [[], []]
        try:
            for which, ask in enumerate(
                (node.get_service_names_and_types_by_node, node.get_client_names_and_types_by_node)
            ):
                for service, types in ask(name, namespace):
                    found[which].extend((service, type) for type in types)
                    types_of.setdefault(service, tuple(types))
                    ends.setdefault(service, ([], []))[which].append(ProviderInfo(full, local=full == marks.node))
        except NodeNameNonExistentError:
            continue  # it has left meanwhile
        nodes[full] = NodeInfo(
            full,
            tuple(sorted(set(publishes.get(full, ())))),
            tuple(sorted(set(subscribes.get(full, ())))),
            tuple(sorted(set(found[0]))),
            tuple(sorted(set(found[1]))),
            local=full == marks.node,
        )
    services = {
        name: ServiceInfo(name, types_of[name], tuple(servers), tuple(clients))
        for name, (servers, clients) in sorted(ends.items())
    }
    return nodes, services


def _gid(end: Any) -> bytes:
    return bytes(end.endpoint_gid)[:GID_BYTES]


def _node_name(namespace: str, name: str) -> str:
    return "" if name == _UNKNOWN else f"{namespace.rstrip('/')}/{name}"


def _type_hash(end: Any) -> str:
    told = getattr(end, "topic_type_hash", None)  # since Iron
    text = "" if told is None else str(told)
    return text if text.startswith("RIHS") and not text.endswith("_" + "0" * 64) else ""
