"""The table of what tokens tell, on the loop: nodes, endpoints, and the events of their coming and going."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from ropeway.graph.actions import action_of_service, actions_of, service_of_action
from ropeway.graph.base import EndpointInfo, GraphEvent, NodeInfo, TopicInfo
from ropeway.graph.calls import ActionInfo, ProviderInfo, ServiceInfo
from ropeway.limits import ZENOH_TOKENS
from ropeway.networks.dds.names import is_hidden, is_of_action
from ropeway.networks.zenoh.tokens import NO_HASH, ZenohToken, gid_of, parse_token

__all__ = ["Named", "SenderIdentity", "ZenohDiscovery"]

log = logging.getLogger("ropeway.zenoh")

_TOPIC_KINDS: Final = ("publisher", "subscription")
_BOUND_SAID: Final = "%s: more than %d tokens; the others are not listed"


class SenderIdentity(NamedTuple):
    """Tells who has sent something: the node, and whether it is a Ropeway, another gateway, and to be heard."""

    node: str
    ours: bool
    relayed: bool
    wanted: bool


@dataclass(slots=True)
class _Endpoint:
    token: ZenohToken
    gid: bytes
    local: bool


@dataclass(slots=True)
class Named:
    """The endpoints of one topic or service, by their tokens."""

    publishers: dict[str, _Endpoint] = field(default_factory=dict)
    subscriptions: dict[str, _Endpoint] = field(default_factory=dict)
    servers: dict[str, _Endpoint] = field(default_factory=dict)
    clients: dict[str, _Endpoint] = field(default_factory=dict)

    def of(self, kind: str) -> dict[str, _Endpoint]:
        """Return those of one kind."""
        found: dict[str, _Endpoint] = getattr(self, f"{kind}s")
        return found


class ZenohDiscovery:
    """Keeps the tokens of a domain.

    ``emit`` gets the events of others; ``changed`` the names whose endpoints elsewhere changed, once per batch: of
    topics and of services. ``identities`` tells by gid who sent a message; threads read it, too.
    """

    def __init__(
        self,
        graph: str,
        gateway_id: str,
        emit: Callable[[GraphEvent], None],
        changed: Callable[[set[str], set[str]], None],
    ) -> None:
        self._graph, self._gateway_id = graph, gateway_id
        self._emit, self._changed = emit, changed
        self._session = ""
        self.malformed = 0
        self.unlisted = 0
        self.identities: dict[bytes, SenderIdentity] = {}
        self._nodes: dict[str, ZenohToken] = {}
        self._endpoints: dict[str, _Endpoint] = {}
        self._topics: dict[str, Named] = {}
        self._services: dict[str, Named] = {}

    def apply(self, batch: Iterable[tuple[str, bool]]) -> None:
        """Take in tokens that have come or gone."""
        topics: set[str] = set()
        services: set[str] = set()
        for key, alive in batch:
            if not alive:
                self._remove(key, topics, services)
            elif key not in self._endpoints and key not in self._nodes:
                self._add(key, topics, services)
        if topics or services:
            self._changed(topics, services)

    def set_session(self, id: str) -> None:
        """Take note of the id of our own session."""
        self._session = id

    # Queries ----------------------------------------------------------------------------------------------------

    def topics(self) -> dict[str, TopicInfo]:
        """Return every topic, with its endpoints; those that belong to actions stand under ``actions``."""
        return {
            name: self._topic(name, named) for name, named in sorted(self._topics.items()) if not is_of_action(name)
        }

    def services(self) -> dict[str, ServiceInfo]:
        """Return every service, with its servers and clients, those of actions too."""
        return {name: self._service(name, named) for name, named in sorted(self._services.items())}

    def actions(self) -> dict[str, ActionInfo]:
        """Return every action."""
        return actions_of(self.services())

    def look_up(self, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None:
        """See ``Graph.look_up``."""
        if kind == "topic":
            topic = None if is_of_action(name) else self._topics.get(name)
            return self._topic(name, topic) if topic is not None else None
        service = name if kind == "service" else service_of_action(name)
        found = self._services.get(service)
        if found is None:
            return None
        info = self._service(service, found)
        return info if kind == "service" else actions_of({service: info}).get(name)

    def nodes(self) -> dict[str, NodeInfo]:
        """Return every node, with what it publishes, reads, serves and calls."""
        used: dict[str, dict[str, set[tuple[str, str]]]] = {}
        local: set[str] = set()
        for token in self._nodes.values():
            used.setdefault(token.node, {})
            if token.session == self._session:
                local.add(token.node)
        for endpoint in self._endpoints.values():
            token = endpoint.token
            entry = (token.name, token.type)
            used.setdefault(token.node, {}).setdefault(token.kind, set()).add(entry)
        return {
            name: NodeInfo(
                name,
                tuple(sorted(uses.get("publisher", ()))),
                tuple(sorted(uses.get("subscription", ()))),
                tuple(sorted(uses.get("server", ()))),
                tuple(sorted(uses.get("client", ()))),
                local=name in local,
            )
            for name, uses in sorted(used.items())
        }

    def others(self, kind: str, name: str, type: str) -> list[ZenohToken]:
        """Return the endpoints of a kind that are not of our own gateway, each once."""
        named = (self._topics if kind in _TOPIC_KINDS else self._services).get(name)
        if named is None:
            return []
        return [
            endpoint.token
            for endpoint in named.of(kind).values()
            if endpoint.token.type == type and not endpoint.token.copy and not self._is_own(endpoint)
        ]

    def hashes(self, kind: str, name: str, type: str) -> set[str]:
        """Return the hashes under which others know the type of a topic or service."""
        return {token.type_hash for token in self.others(kind, name, type)}

    def hash_of(self, type: str) -> str:
        """Return a hash under which others know a type, ``NO_HASH`` where nobody does."""
        found = (end.token.type_hash for end in self._endpoints.values() if end.token.type == type and not end.local)
        return next((hash for hash in found if hash != NO_HASH), NO_HASH)

    # Changes ----------------------------------------------------------------------------------------------------

    def _add(self, key: str, topics: set[str], services: set[str]) -> None:
        token = parse_token(key)
        if token is None:
            self.malformed += 1
            return
        if len(self._endpoints) + len(self._nodes) >= ZENOH_TOKENS:
            self.unlisted += 1
            if self.unlisted == 1:
                log.warning(_BOUND_SAID, self._graph, ZENOH_TOKENS)
            return
        local = token.session == self._session
        if token.kind == "node":
            self._nodes[key] = token
            if not local:
                self._tell(token, True)
            return
        endpoint = self._endpoints[key] = _Endpoint(token, gid_of(key), local)
        own = self._is_own(endpoint)
        relayed, wanted = bool(token.gateway) and not own, not (own or token.copy)
        self.identities[endpoint.gid] = SenderIdentity(token.node, token.ours, relayed, wanted)
        table, changed = self._table(token, topics, services)
        table.setdefault(token.name, Named()).of(token.kind)[key] = endpoint
        if not local:
            changed.add(token.name)
            self._tell(token, True)

    def _remove(self, key: str, topics: set[str], services: set[str]) -> None:
        node = self._nodes.pop(key, None)
        if node is not None:
            if node.session != self._session:
                self._tell(node, False)
            return
        endpoint = self._endpoints.pop(key, None)
        if endpoint is None:
            return
        token = endpoint.token
        self.identities.pop(endpoint.gid, None)
        table, changed = self._table(token, topics, services)
        named = table[token.name]
        del named.of(token.kind)[key]
        if not (named.publishers or named.subscriptions or named.servers or named.clients):
            del table[token.name]
        if not endpoint.local:
            changed.add(token.name)
            self._tell(token, False)

    def _table(self, token: ZenohToken, topics: set[str], services: set[str]) -> tuple[dict[str, Named], set[str]]:
        return (self._topics, topics) if token.kind in _TOPIC_KINDS else (self._services, services)

    def _tell(self, token: ZenohToken, discovered: bool) -> None:
        kind = token.kind
        if kind == "node":
            self._emit(GraphEvent(discovered, "node", token.node, graph=self._graph))
        elif kind == "server":
            action = action_of_service(token.name, token.type)
            if action is not None:
                self._emit(GraphEvent(discovered, "action", *action, token.node, self._graph))
            elif not is_hidden(token.name):
                self._emit(GraphEvent(discovered, "service", token.name, token.type, token.node, self._graph))
        elif kind in _TOPIC_KINDS and not is_hidden(token.name):
            self._emit(GraphEvent(discovered, kind, token.name, token.type, token.node, self._graph))

    def _is_own(self, endpoint: _Endpoint) -> bool:
        return endpoint.local or (bool(self._gateway_id) and endpoint.token.gateway == self._gateway_id)

    def _topic(self, name: str, named: Named) -> TopicInfo:
        publishers = tuple(map(_endpoint_info, named.publishers.values()))
        subscriptions = tuple(map(_endpoint_info, named.subscriptions.values()))
        types = tuple(dict.fromkeys(end.type for end in publishers + subscriptions))
        return TopicInfo(name, types, publishers, subscriptions)

    def _service(self, name: str, named: Named) -> ServiceInfo:
        ends = [*named.servers.values(), *named.clients.values()]
        return ServiceInfo(
            name,
            tuple(dict.fromkeys(end.token.type for end in ends)),
            tuple(map(_provider_info, named.servers.values())),
            tuple(map(_provider_info, named.clients.values())),
        )


def _endpoint_info(endpoint: _Endpoint) -> EndpointInfo:
    token = endpoint.token
    return EndpointInfo(
        kind=token.kind,
        topic=token.name,
        type=token.type,
        qos=token.qos,
        gid=endpoint.gid,
        node=token.node,
        type_hash="" if token.type_hash == NO_HASH else token.type_hash,
        gateway=token.gateway,
        local=endpoint.local,
    )


def _provider_info(endpoint: _Endpoint) -> ProviderInfo:
    return ProviderInfo(endpoint.token.node, endpoint.token.gateway, endpoint.local, endpoint.gid)
