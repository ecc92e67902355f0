"""The ``overlay`` graph: one way into the overlay, with metadata of its own.

Names become global ones (see ``names``): only who has the fleet's name secret can make or guess them.
What is published is sealed for those who may read it, whoever carries it.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Final

from ropeway.errors import GraphUnavailable, SealError, TypeConflict
from ropeway.graph.actions import action_of_service
from ropeway.graph.base import (
    NO_HINTS,
    Delivery,
    EndpointInfo,
    GraphEvent,
    NodeInfo,
    SampleCallback,
    TopicInfo,
    resolve_name,
)
from ropeway.graph.calls import ProviderInfo, ServiceHandler, ServiceInfo
from ropeway.graph.graph_base import ComposingGraph
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.graph.calls import OverlayClient, OverlayService
from ropeway.networks.overlay.graph.publisher import OverlayPublisher
from ropeway.networks.overlay.graph.sender import OverlaySender
from ropeway.networks.overlay.graph.subscription import OverlaySubscription
from ropeway.networks.overlay.names import Metadata, global_name
from ropeway.networks.overlay.node import OverlayNode, new_endpoint
from ropeway.qos import DEFAULT, QoS
from ropeway.tasks import Chores
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name

__all__ = ["OverlayGraph"]

_ACTION_PART: Final = "/_action/"
_FOREVER_NS: Final = 365 * 86_400 * 10**9
_TOPICS: Final = ("publisher", "subscription")


class OverlayGraph(ComposingGraph):
    """A participant of the overlay that ``node`` is a member of.

    ``metadata`` goes into every name; ``readers`` and ``callers`` are patterns of certificate names that may read and
    call what is offered here, beyond what their certificates say. ``lane`` is the priority of calls. ``node_name`` is
    told with what is advertised.
    """

    kind = "overlay"
    target = b""  # the only gateway that this has to do with
    lane = 2
    nobody_s = 1.0

    def __init__(
        self,
        node: OverlayNode,
        *,
        metadata: Metadata | None = None,
        readers: Sequence[str] = ("*",),
        callers: Sequence[str] = ("*",),
        registry: TypeRegistry | None = None,
        label: str = "overlay",
        node_name: str = "",
    ) -> None:
        super().__init__(label, registry)
        self.node = node
        self.metadata = metadata or Metadata()
        self.node_name = node_name
        self.sender: OverlaySender
        self.patterns = {"subscribe": tuple(readers), "call": tuple(callers)}
        self._publishers: dict[bytes, OverlayPublisher] = {}
        self._subscriptions: dict[bytes, OverlaySubscription] = {}
        self._services: dict[bytes, OverlayService] = {}
        self._clients: dict[bytes, OverlayClient] = {}
        self._matched: dict[bytes, list[OverlayPublisher | OverlaySubscription | OverlayClient]] = {}
        self._stop: Callable[[], None] | None = None
        self.answers: dict[str, str] = {}  # topics on which what is published for one gateway is answered
        self.closing = Chores()

    # ── life ───────────────────────────────────────────────────────────────────────────────────────────────────

    async def _join(self) -> None:
        await self.node.open()
        self.sender = OverlaySender(self)
        self._stop = self.node.rib.on_change(self._changed)

    async def _close_parts(self) -> None:
        for parts in (self._clients, self._services, self._publishers, self._subscriptions):
            await asyncio.gather(*(part.close() for part in parts.values()))
        await self.closing.wait()

    async def _leave(self) -> None:
        if self._stop is not None:
            self._stop()
        await self.sender.close()
        await self.node.close()

    @property
    def untold(self) -> str:
        """See ``Telling.untold``."""
        if self.node.fabric.links():
            return ""
        return f"no router can be reached ({', '.join(self.node.routers) or 'none is named'})"

    def _check(self, name: str, type: str) -> None:
        self._check_open()
        if not type:
            raise TypeConflict(name, "a type", "none")

    def allows(self, verb: str, name: str, certificate: Certificate) -> bool:
        """Return whether the owner of a certificate may read or call what is offered here."""
        listed = any(fnmatchcase(certificate.name, pattern) for pattern in self.patterns.get(verb, ("*",)))
        return listed and self.node.policy(verb, name, certificate)

    def _advert(self, kind: str, name: str, type: str, qos: QoS | None, delivery: Delivery) -> Advertisement:
        now = time.time_ns()
        metadata = self._metadata(delivery)
        return Advertisement(
            kind=kind,
            global_name=self._global(kind, name, type, metadata),
            endpoint=new_endpoint(),
            gateway=self.node.gateway,
            name=name,
            type=type,
            qos=qos,
            encoding=delivery.encoding if kind in _TOPICS else "",
            metadata=metadata,
            since_ns=now,
            expires_ns=now + _FOREVER_NS,
            node=metadata.node or self.node_name,
            target=self.target,
        )

    def _metadata(self, delivery: Delivery) -> Metadata:
        return replace(self.metadata, **dict(delivery.metadata)) if delivery.metadata else self.metadata

    def name_of(self, kind: str, name: str, type: str, delivery: Delivery = NO_HINTS) -> bytes:
        """Return the global name of a part: of a ``publisher``, ``subscription``, ``service`` or ``client``."""
        full = canonical_name(type, "msg" if kind in _TOPICS else "srv")
        return self._global(kind, resolve_name(name), full, self._metadata(delivery))

    def _global(self, kind: str, name: str, type: str, metadata: Metadata) -> bytes:
        what = "topic" if kind in _TOPICS else "service"
        return global_name(self.node.secret, what, name, type, metadata)

    def _advertise(self, advert: Advertisement) -> None:
        try:
            self.node.advertise(advert)
        except SealError as error:
            raise GraphUnavailable(self.name, str(error)) from error

    def _match(self, part: OverlayPublisher | OverlaySubscription | OverlayClient) -> None:
        self._matched.setdefault(part.advert.global_name, []).append(part)
        part.rematch()

    def _unmatch(self, part: OverlayPublisher | OverlaySubscription | OverlayClient) -> None:
        parts = self._matched.get(part.advert.global_name, [])
        if part in parts:
            parts.remove(part)
        if not parts:
            self._matched.pop(part.advert.global_name, None)

    # ── topics ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> OverlayPublisher:
        """Publish ``topic``. Raises ``GraphUnavailable`` where our certificate does not allow it."""
        self._check(topic, type)
        return self._publish(topic, type, qos or DEFAULT, delivery, self.target)

    def publish_to(self, target: bytes, topic: str, type: str, qos: QoS, delivery: Delivery) -> OverlayPublisher:
        """Publish ``topic`` for one gateway alone."""
        return self._publish(topic, type, qos, delivery, target)

    def _publish(self, topic: str, type: str, qos: QoS, delivery: Delivery, target: bytes) -> OverlayPublisher:
        name = resolve_name(topic)
        advert = self._advert("publisher", name, canonical_name(type, "msg"), qos, delivery)
        advert = replace(advert, target=target, answers=self.answers.get(name, "") if target else "")
        publisher = OverlayPublisher(self, advert, delivery)
        self._advertise(advert)
        self._publishers[advert.endpoint] = publisher
        self.node.sources[advert.endpoint] = publisher.source
        self.node.on_granted[advert.endpoint] = publisher.granted
        self.sender.open(publisher.queue)
        self._match(publisher)
        return publisher

    def remove_publisher(self, publisher: OverlayPublisher) -> None:
        """Remove a closed publisher."""
        endpoint = publisher.advert.endpoint
        self._publishers.pop(endpoint, None)
        self._unmatch(publisher)
        self.node.sources.pop(endpoint, None)
        self.node.on_granted.pop(endpoint, None)
        self.sender.drop(publisher.queue)
        self.node.withdraw(endpoint)

    async def create_subscription(
        self,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> OverlaySubscription:
        """Read ``topic``. Raises ``GraphUnavailable`` where our certificate does not allow it."""
        self._check(topic, type)
        advert = self._advert("subscription", resolve_name(topic), canonical_name(type, "msg"), qos, delivery)
        self._advertise(advert)
        feed = self.node.feed(advert.global_name)
        subscription = OverlaySubscription(self, advert, qos, callback, feed)
        self._subscriptions[advert.endpoint] = subscription
        feed.readers.append(subscription)
        self.node.follow(feed)
        self._match(subscription)
        return subscription

    async def remove_subscription(self, subscription: OverlaySubscription) -> None:
        """Remove a closed subscription."""
        self._subscriptions.pop(subscription.endpoint, None)
        self._unmatch(subscription)
        if subscription in subscription.feed.readers:
            subscription.feed.readers.remove(subscription)
        self.node.withdraw(subscription.endpoint)
        await self.node.release(subscription.feed)

    # ── services and actions ───────────────────────────────────────────────────────────────────────────────────

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> OverlayClient:
        """Call ``service``. Raises ``GraphUnavailable`` where our certificate does not allow it."""
        self._check(service, type)
        advert = self._advert("client", resolve_name(service), canonical_name(type, "srv"), None, delivery)
        self._advertise(advert)
        client = self._clients[advert.endpoint] = OverlayClient(self, advert)
        self._match(client)
        return client

    def remove_client(self, client: OverlayClient) -> None:
        """Remove a closed client."""
        self._clients.pop(client.endpoint, None)
        self._unmatch(client)
        self.node.withdraw(client.endpoint)

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> OverlayService:
        """Serve ``service``; others may serve it as well. Raises ``GraphUnavailable`` as above."""
        self._check(service, type)
        advert = self._advert("service", resolve_name(service), canonical_name(type, "srv"), None, delivery)
        served = OverlayService(self, advert, handler)
        self._advertise(advert)
        self._services[advert.endpoint] = self.node.providers[advert.endpoint] = served
        return served

    def remove_service(self, service: OverlayService) -> None:
        """Remove a closed service."""
        self._services.pop(service.endpoint, None)
        self.node.providers.pop(service.endpoint, None)
        self.node.withdraw(service.endpoint)

    # ── what is there ──────────────────────────────────────────────────────────────────────────────────────────

    def _changed(self, advert: Advertisement, added: bool) -> None:
        """React to an endpoint that is advertised, or no longer."""
        if advert.kind == "publisher" and (feed := self.node.feeds.get(advert.global_name)) is not None:
            self.node.follow(feed)
        for part in list(self._matched.get(advert.global_name, ())):
            part.rematch()
        if advert.answers:
            for publisher in list(self._publishers.values()):
                if publisher.topic == advert.answers:
                    publisher.rematch()
        self._tell(advert, added)

    def _tell(self, advert: Advertisement, added: bool) -> None:
        kind, node = advert.kind, self._node_of(advert.gateway)
        if kind == "client" or (kind in _TOPICS and _ACTION_PART in advert.name):
            return
        self._changes.emit(GraphEvent(added, kind, advert.name, advert.type, node, self.name))
        if kind == "service" and (action := action_of_service(advert.name, advert.type)) is not None:
            self._changes.emit(GraphEvent(added, "action", *action, node, self.name))

    def _node_of(self, gateway: bytes) -> str:
        if gateway == self.node.gateway:
            return _node_name(self.node.identity.name)
        certificate = self.node.membership.certificate(gateway)
        return _node_name(certificate.name) if certificate is not None else ""

    def _all(self, *kinds: str) -> list[Advertisement]:
        """Return what others advertise, and what we do."""
        own: list[Advertisement] = []
        for parts in (self._publishers, self._subscriptions, self._services, self._clients):
            own += [part.advert for part in parts.values()]
        theirs = [advert for kind in kinds for advert in self.node.rib.all(kind)]
        return [advert for advert in own if advert.kind in kinds] + theirs

    def topics(self) -> dict[str, TopicInfo]:
        """Return what is advertised now; the topics of actions stand under ``actions``."""
        found: dict[str, tuple[list[EndpointInfo], list[EndpointInfo]]] = {}
        for advert in self._all(*_TOPICS):
            if _ACTION_PART in advert.name:
                continue
            local = advert.gateway == self.node.gateway
            gateway = self._node_of(advert.gateway)
            info = EndpointInfo(
                advert.kind,
                advert.name,
                advert.type,
                advert.qos or DEFAULT,
                gid=advert.endpoint,
                node=gateway,
                gateway="" if local else gateway.lstrip("/"),
                local=local,
            )
            found.setdefault(advert.name, ([], []))[advert.kind == "subscription"].append(info)
        return {
            name: TopicInfo(name, tuple(dict.fromkeys(e.type for e in pubs + subs)), tuple(pubs), tuple(subs))
            for name, (pubs, subs) in sorted(found.items())
        }

    def services(self) -> dict[str, ServiceInfo]:
        """Return the services that are offered and called now."""
        found: dict[str, tuple[list[Advertisement], list[Advertisement]]] = {}
        for advert in self._all("service", "client"):
            found.setdefault(advert.name, ([], []))[advert.kind == "client"].append(advert)
        return {
            name: ServiceInfo(
                name,
                tuple(dict.fromkeys(advert.type for advert in (*servers, *clients))),
                tuple(map(self._provider, servers)),
                tuple(map(self._provider, clients)),
            )
            for name, (servers, clients) in sorted(found.items())
        }

    def _provider(self, advert: Advertisement) -> ProviderInfo:
        local = advert.gateway == self.node.gateway
        gateway = self._node_of(advert.gateway)
        return ProviderInfo(gateway, "" if local else gateway.lstrip("/"), local, advert.endpoint, advert.since_ns)

    def types_of(self, kind: str, name: str) -> tuple[str, ...]:
        """See ``Graph.types_of``."""
        if kind == "action":
            info = self.actions().get(name)
            return info.types if info is not None else ()
        kinds = _TOPICS if kind == "topic" else ("service", "client")
        return tuple(dict.fromkeys(advert.type for advert in self._all(*kinds) if advert.name == name))

    def nodes(self) -> dict[str, NodeInfo]:
        """Return every gateway, as a node."""
        parts: dict[bytes, dict[str, list[tuple[str, str]]]] = {self.node.gateway: {}}
        for gateway in self.node.membership.gateways():
            parts[gateway] = {}
        for advert in self._all(*_TOPICS, "service", "client"):
            parts.setdefault(advert.gateway, {}).setdefault(advert.kind, []).append((advert.name, advert.type))
        out: dict[str, NodeInfo] = {}
        for gateway, names in parts.items():
            node = self._node_of(gateway)
            lists = (tuple(sorted(names.get(kind, ()))) for kind in (*_TOPICS, "service", "client"))
            publishers, subscriptions, services, clients = lists
            local = gateway == self.node.gateway
            out[node] = NodeInfo(node, publishers, subscriptions, services, clients, local)
        return out


def _node_name(name: str) -> str:
    """Turn a certificate's name into that of a node: what ROS does not allow becomes an underscore."""
    part = "".join(c if c == "_" or (c.isascii() and c.isalnum()) else "_" for c in name)
    return f"/{part if part and not part[0].isdigit() else f'_{part}'}"
