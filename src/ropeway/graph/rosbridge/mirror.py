"""The far graph as it was shown to us: told by a gateway, or asked from rosapi."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from ropeway.graph.base import Changes, EndpointInfo, GraphEvent, NodeInfo, TopicInfo
from ropeway.qos import DEFAULT, QoS

__all__ = ["Mirror", "describe"]

Call = Callable[[str, Mapping[str, Any]], Awaitable[Mapping[str, Any]]]


class Mirror:
    """Keeps ``topics`` and ``nodes``, and emits an event for every difference."""

    def __init__(self, graph: str, changes: Changes) -> None:
        self.topics: dict[str, TopicInfo] = {}
        self.nodes: dict[str, NodeInfo] = {}
        self.filled = asyncio.Event()
        self._graph, self._changes = graph, changes

    def clear(self) -> None:
        """The link is down: nothing is known."""
        self._replace({}, {})
        self.filled.clear()

    def update(self, message: Mapping[str, Any]) -> None:
        """Take what a gateway told: changed topics and nodes (``null`` for those that are gone)."""
        topics, nodes = dict(self.topics), dict(self.nodes)
        for name, value in _items(message.get("topics")):
            if value is None:
                topics.pop(name, None)
            elif isinstance(value, Mapping):
                topics[name] = _topic(name, value)
        for name, value in _items(message.get("nodes")):
            if value is None:
                nodes.pop(name, None)
            elif isinstance(value, Mapping):
                nodes[name] = _node(name, value)
        self._replace(topics, nodes)
        self.filled.set()

    async def ask_rosapi(self, call: Call) -> None:
        """Ask a plain rosbridge server; it tells names and types of topics, and names of nodes."""
        answer = await call("/rosapi/topics", {})
        names, types = answer.get("topics"), answer.get("types")
        topics: dict[str, TopicInfo] = {}
        if isinstance(names, list) and isinstance(types, list):
            for name, type in zip(names, types, strict=False):
                if isinstance(name, str) and isinstance(type, str):
                    topics[name] = TopicInfo(name, (type,))
        answer = await call("/rosapi/nodes", {})
        listed = answer.get("nodes")
        nodes = {n: NodeInfo(n) for n in listed if isinstance(n, str)} if isinstance(listed, list) else {}
        self._replace(topics, nodes)
        self.filled.set()

    def _replace(self, topics: dict[str, TopicInfo], nodes: dict[str, NodeInfo]) -> None:
        before, self.topics = self.topics, topics
        nodes_before, self.nodes = self.nodes, nodes
        old, new = _uses(before), _uses(topics)
        for kind, name, type, node, _ in sorted(new - old):
            self._changes.emit(GraphEvent(True, kind, name, type, node, self._graph))
        for kind, name, type, node, _ in sorted(old - new):
            self._changes.emit(GraphEvent(False, kind, name, type, node, self._graph))
        for name in sorted(nodes.keys() ^ nodes_before.keys()):
            self._changes.emit(GraphEvent(name in nodes, "node", name, graph=self._graph))


def _uses(topics: Mapping[str, TopicInfo]) -> set[tuple[str, str, str, str, bytes]]:
    ends = (e for t in topics.values() for e in (*t.publishers, *t.subscriptions))
    return {(e.kind, e.topic, e.type, e.node, e.gid) for e in ends}


def _items(value: object) -> list[tuple[str, Any]]:
    return [(k, v) for k, v in value.items() if isinstance(k, str)] if isinstance(value, Mapping) else []


def _endpoint(kind: str, topic: str, value: Mapping[str, Any]) -> EndpointInfo:
    try:
        qos = QoS.parse(value.get("qos", {}))
    except ValueError:
        qos = DEFAULT
    text = {k: str(value.get(k, "")) for k in ("type", "node", "type_hash", "gateway")}
    gid = value.get("gid", "")
    return EndpointInfo(
        kind,
        topic,
        text["type"],
        qos,
        _hex(gid),
        text["node"],
        text["type_hash"],
        text["gateway"],
        local=bool(value.get("local", False)),
    )


def _hex(value: object) -> bytes:
    try:
        return bytes.fromhex(value) if isinstance(value, str) else b""
    except ValueError:
        return b""


def _topic(name: str, value: Mapping[str, Any]) -> TopicInfo:
    def endpoints(key: str, kind: str) -> tuple[EndpointInfo, ...]:
        listed = value.get(key)
        return (
            tuple(_endpoint(kind, name, e) for e in listed if isinstance(e, Mapping))
            if isinstance(listed, list)
            else ()
        )

    types = value.get("types")
    return TopicInfo(
        name,
        tuple(str(t) for t in types) if isinstance(types, list) else (),
        endpoints("publishers", "publisher"),
        endpoints("subscriptions", "subscription"),
    )


def _node(name: str, value: Mapping[str, Any]) -> NodeInfo:
    def pairs(key: str) -> tuple[tuple[str, str], ...]:
        listed = value.get(key)
        if not isinstance(listed, list):
            return ()
        return tuple((str(p[0]), str(p[1])) for p in listed if isinstance(p, list) and len(p) == 2)

    return NodeInfo(name, pairs("publishers"), pairs("subscriptions"), pairs("services"), pairs("clients"))


def describe(topics: Mapping[str, TopicInfo], nodes: Mapping[str, NodeInfo]) -> dict[str, Any]:
    """The JSON form of a graph, which ``Mirror.update`` reads."""

    def endpoint(e: EndpointInfo) -> dict[str, Any]:
        return {
            "type": e.type,
            "qos": e.qos.to_json(),
            "gid": e.gid.hex(),
            "node": e.node,
            "type_hash": e.type_hash,
            "gateway": e.gateway,
            "local": e.local,
        }

    return {
        "topics": {
            name: {
                "types": list(t.types),
                "publishers": [endpoint(e) for e in t.publishers],
                "subscriptions": [endpoint(e) for e in t.subscriptions],
            }
            for name, t in topics.items()
        },
        "nodes": {
            name: {
                "publishers": [list(p) for p in n.publishers],
                "subscriptions": [list(p) for p in n.subscriptions],
                "services": [list(p) for p in n.services],
                "clients": [list(p) for p in n.clients],
            }
            for name, n in nodes.items()
        },
    }
