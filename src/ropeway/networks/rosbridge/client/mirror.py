"""The far graph as it was shown to us: told by a gateway, or asked from rosapi."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, TypeVar

from ropeway.graph.base import EndpointInfo, GraphEvent, NodeInfo, TopicInfo
from ropeway.graph.calls import ActionInfo, ProviderInfo, ServiceInfo
from ropeway.graph.changes import Changes
from ropeway.qos import DEFAULT, QoS

__all__ = ["RemoteMirror", "describe"]

Call = Callable[[str, Mapping[str, Any]], Awaitable[Mapping[str, Any]]]
_Calls = TypeVar("_Calls", ServiceInfo, ActionInfo)


class RemoteMirror:
    """Keeps topics, nodes, services and actions, and emits an event for every difference.

    ``tells_calls``: who is mirrored tells of services and actions, so that what is not here is not served.
    ``on_calls`` is called when they have changed.
    """

    def __init__(self, graph: str, changes: Changes, on_calls: Callable[[], None]) -> None:
        self.topics: dict[str, TopicInfo] = {}
        self.nodes: dict[str, NodeInfo] = {}
        self.services: dict[str, ServiceInfo] = {}
        self.actions: dict[str, ActionInfo] = {}
        self.tells_calls = False
        self.filled = asyncio.Event()
        self._graph, self._changes, self._on_calls = graph, changes, on_calls

    def clear(self) -> None:
        """Forget everything: the link is down."""
        self._replace({}, {})
        self.tells_calls = False
        self._replace_calls({}, {})
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
        self._update_calls(message)
        self.filled.set()

    def _update_calls(self, message: Mapping[str, Any]) -> None:
        if "services" not in message and "actions" not in message:
            return
        self.tells_calls = True
        services, actions = dict(self.services), dict(self.actions)
        _take(services, message.get("services"), ServiceInfo)
        _take(actions, message.get("actions"), ActionInfo)
        self._replace_calls(services, actions)

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

    async def ask_calls(self, call: Call) -> None:
        """Ask a plain rosbridge server for services and actions; it tells names, and their types one by one."""
        services = await _ask(call, "/rosapi/services", "services", "/rosapi/service_type", "service")
        actions = await _ask(call, "/rosapi/action_servers", "action_servers", "/rosapi/action_type", "action")
        nobody = (ProviderInfo(),)  # somebody serves it, and nobody tells who
        self._replace_calls(
            {n: self.services.get(n) or ServiceInfo(n, (t,) if t else (), nobody) for n, t in services.items()},
            {n: self.actions.get(n) or ActionInfo(n, (t,) if t else (), nobody) for n, t in actions.items()},
        )

    def _replace_calls(self, services: dict[str, ServiceInfo], actions: dict[str, ActionInfo]) -> None:
        before = _providers("service", self.services) | _providers("action", self.actions)
        self.services, self.actions = services, actions
        after = _providers("service", services) | _providers("action", actions)
        for kind, name, type, node, _ in sorted(after - before):
            self._changes.emit(GraphEvent(True, kind, name, type, node, self._graph))
        for kind, name, type, node, _ in sorted(before - after):
            self._changes.emit(GraphEvent(False, kind, name, type, node, self._graph))
        self._on_calls()

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


def _providers(kind: str, table: Mapping[str, ServiceInfo | ActionInfo]) -> set[tuple[str, str, str, str, bytes]]:
    return {(kind, i.name, i.type, p.node, p.gid) for i in table.values() for p in i.servers}


async def _ask(call: Call, list_service: str, key: str, type_service: str, field: str) -> dict[str, str]:
    """Return the names that rosapi lists, with their types."""
    names = (await call(list_service, {})).get(key)
    found: dict[str, str] = {}
    for name in names if isinstance(names, list) else ():
        if isinstance(name, str):
            type = (await call(type_service, {field: name})).get("type")
            found[name] = type if isinstance(type, str) else ""
    return found


def _take(table: dict[str, _Calls], told: object, make: type[_Calls]) -> None:
    """Take the services or actions that a gateway told; ``null`` for those that are gone."""
    for name, value in _items(told):
        if value is None:
            table.pop(name, None)
        elif isinstance(value, Mapping):
            types = value.get("types")
            table[name] = make(
                name,
                tuple(str(t) for t in types) if isinstance(types, list) else (),
                _provider_list(value.get("servers")),
                _provider_list(value.get("clients")),
            )


def _provider_list(listed: object) -> tuple[ProviderInfo, ...]:
    return tuple(_provider(p) for p in listed if isinstance(p, Mapping)) if isinstance(listed, list) else ()


def _provider(value: Mapping[str, Any]) -> ProviderInfo:
    since = value.get("since_ns", 0)
    return ProviderInfo(
        str(value.get("node", "")),
        str(value.get("gateway", "")),
        local=bool(value.get("local", False)),
        gid=_hex(value.get("gid", "")),
        since_ns=since if type(since) is int else 0,
    )


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


def describe(
    topics: Mapping[str, TopicInfo],
    nodes: Mapping[str, NodeInfo],
    services: Mapping[str, ServiceInfo],
    actions: Mapping[str, ActionInfo],
) -> dict[str, Any]:
    """Return the JSON form of a graph, which ``RemoteMirror.update`` reads."""

    def provider(p: ProviderInfo) -> dict[str, Any]:
        told = {"node": p.node, "gateway": p.gateway, "local": p.local, "gid": p.gid.hex(), "since_ns": p.since_ns}
        return {key: value for key, value in told.items() if value}

    def calls(table: Mapping[str, ServiceInfo | ActionInfo]) -> dict[str, Any]:
        return {
            name: {
                "types": list(i.types),
                "servers": [provider(p) for p in i.servers],
                "clients": [provider(p) for p in i.clients],
            }
            for name, i in table.items()
        }

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
        "services": calls(services),
        "actions": calls(actions),
    }
