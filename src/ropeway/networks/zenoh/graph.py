"""The ``zenoh`` graph: a ROS 2 network on rmw_zenoh reached without ROS, through Zenoh's own library."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Any

import zenoh

from ropeway.errors import GraphUnavailable, InvalidName
from ropeway.graph.base import (
    NO_HINTS,
    Delivery,
    NodeInfo,
    SampleCallback,
    TopicInfo,
    Undelivered,
    resolve_name,
)
from ropeway.graph.calls import ActionInfo, ServiceHandler, ServiceInfo
from ropeway.graph.graph_base import ComposingGraph
from ropeway.graph.inlet import Inlet
from ropeway.graph.layout_border import Border
from ropeway.graph.type_answers import offer_descriptions
from ropeway.limits import ZENOH_TOKENS_BYTES
from ropeway.networks.zenoh.address import ZenohAddress
from ropeway.networks.zenoh.client import ZenohClient
from ropeway.networks.zenoh.discovery import ZenohDiscovery
from ropeway.networks.zenoh.hashed_layouts import HashedLayouts
from ropeway.networks.zenoh.publisher import ZenohPublisher
from ropeway.networks.zenoh.readers import ZenohReaders, ZenohSubscription
from ropeway.networks.zenoh.sender import Sender
from ropeway.networks.zenoh.service import ZenohService
from ropeway.networks.zenoh.session import ZenohSession
from ropeway.networks.zenoh.session_config import make_config
from ropeway.networks.zenoh.tokens import NO_HASH, tokens_of
from ropeway.qos import DEFAULT, QoS, settled
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name

__all__ = ["TOKENS", "ZenohGraph"]

log = logging.getLogger("ropeway.zenoh")

TOKENS = "@ros2_lv"
"""The name under which tokens that cannot be read are counted in ``drops``."""

_ALL_S = 5.0  # the tokens that are there have come by then


class ZenohGraph(ComposingGraph):
    """The node ``namespace``/``name`` on the network of rmw_zenoh that ``address`` names.

    ``gateway_id`` marks it, so that other processes of the same gateway ignore it and other gateways know it.
    ``registry`` has our types, ``network`` those of this network where they are known to be others. ``label`` is how
    the graph is written; ``clock`` gives nanoseconds for ``Sample.stamp_ns``.
    """

    kind = "zenoh"

    def __init__(
        self,
        address: ZenohAddress,
        *,
        label: str = "zenoh",
        name: str = "ropeway",
        namespace: str = "/",
        gateway_id: str = "",
        registry: TypeRegistry | None = None,
        network: TypeRegistry | None = None,
        clock: Callable[[], int] = time.time_ns,
    ) -> None:
        super().__init__(label, registry)
        if "/" in name:
            raise InvalidName(name, "a node name has no slash; give the namespace apart")
        self.node = resolve_name(name, namespace)
        self.gateway_id = gateway_id
        self.layouts = HashedLayouts(Border(self.registry, network))
        self._address = address
        self._clock = clock
        self.session = ZenohSession(label, address.domain, self.node, gateway_id, self._on_own_token)
        self.discovery: ZenohDiscovery
        self.sender: Sender
        self._readers: ZenohReaders
        self._tokens: Inlet[tuple[str, bool] | None]
        self._missed = 0
        self._listening: Any = None
        self._settled = False

    async def _join(self) -> None:
        try:
            config = make_config(self._address)
        except ValueError as error:
            raise GraphUnavailable(self.name, str(error)) from error
        self.discovery = ZenohDiscovery(self.name, self.gateway_id, self._changes.emit, self._on_changed)
        self._readers = ZenohReaders(self, self._clock)
        self._readers.on_closed = self._parts.discard
        self._tokens = Inlet(asyncio.get_running_loop(), self._on_tokens, limit_bytes=ZENOH_TOKENS_BYTES)
        self._missed, self._settled = 0, False
        await self.session.open(config, self.discovery.set_session)
        self.sender = Sender(self.name)
        self._is_open = True
        self._listen()
        self._ask_for_types()
        if self.gateway_id and self._registry is not None:
            await offer_descriptions(self.create_service, self.node, self._registry)
        log.info("%s: joined as node %s", self.name, self.node)

    async def _leave(self) -> None:
        self._tokens.closed = True
        await self.session.close()
        await self.sender.close()

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> ZenohPublisher:
        """Publish ``topic``; without a profile, reliable and volatile. Zenoh has its own way with ``delivery``."""
        self._check_open()
        topic, type = resolve_name(topic), canonical_name(type)
        publisher = ZenohPublisher(self, topic, type, settled(qos or DEFAULT, DEFAULT), self._hash(type))
        self._parts.add(publisher)
        publisher.follow()
        return publisher

    async def create_subscription(
        self,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> ZenohSubscription:
        """Read ``topic``; without a profile, with what all its publishers offer, also when they change."""
        self._check_open()
        subscription = ZenohSubscription(self._readers, resolve_name(topic), canonical_name(type), qos, callback)
        self._readers.begin(subscription)
        self._parts.add(subscription)
        return subscription

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> ZenohClient:
        """Call ``service``."""
        self._check_open()
        service, type = resolve_name(service), canonical_name(type, "srv")
        client = ZenohClient(self, service, type, self._hash(type))
        self._parts.add(client)
        client.follow()
        return client

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> ZenohService:
        """Serve ``service``; for a failed request nodes get the default response, with its text where it has one."""
        self._check_open()
        service, type = resolve_name(service), canonical_name(type, "srv")
        served = ZenohService(self, service, type, handler, self._hash(type))
        self._parts.add(served)
        served.follow()
        return served

    def topics(self) -> dict[str, TopicInfo]:
        """Return every topic in the domain, ours included."""
        return self.discovery.topics() if self._is_open else {}

    def services(self) -> dict[str, ServiceInfo]:
        """Return every service in the domain, ours included."""
        return self.discovery.services() if self._is_open else {}

    def actions(self) -> dict[str, ActionInfo]:
        """Return every action in the domain, ours included."""
        return self.discovery.actions() if self._is_open else {}

    def look_up(self, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None:
        """See ``Graph.look_up``."""
        return self.discovery.look_up(kind, name) if self._is_open else None

    def nodes(self) -> dict[str, NodeInfo]:
        """Return every node in the domain, ours included."""
        return self.discovery.nodes() if self._is_open else {}

    @property
    def settled(self) -> bool:
        """Whether the tokens that were there when we came have been told."""
        return self._settled

    @property
    def distro(self) -> str:
        """See ``Distributed``."""
        return self.layouts.distro

    # For the parts ----------------------------------------------------------------------------------------------

    def withdraw(self, part: ZenohPublisher) -> None:
        """See ``ZenohTopicHost``."""
        self._parts.discard(part)

    def forget(self, part: object) -> None:
        """See ``ZenohCallHost``."""
        self._parts.discard(part)

    def _hash(self, type: str) -> str:
        """Return the hash of a type: as it is defined here, else as others on the network know it."""
        known = self.layouts.own_hash(type)
        return known if known != NO_HASH else self.discovery.hash_of(type)

    # Tokens -----------------------------------------------------------------------------------------------------

    def _listen(self) -> None:
        """Hear of tokens that come and go, and ask for those that are there."""
        session, key = self.session, tokens_of(self._address.domain)
        handler: Any = zenoh.handlers.Callback(self._take_token, indirect=False)
        self._listening = session.attempt(
            lambda: session.raw.liveliness().declare_subscriber(key, handler, history=True)
        )
        self._ask()

    def _ask(self) -> None:
        """Ask for every token that is there."""
        session, key = self.session, tokens_of(self._address.domain)
        handler: Any = zenoh.handlers.Callback(self._take_reply, drop=self._all_told, indirect=False)
        session.attempt(lambda: session.raw.liveliness().get(key, handler, timeout=_ALL_S))

    def _take_token(self, sample: zenoh.Sample) -> None:
        """Take a token, in a thread of Zenoh's."""
        key = str(sample.key_expr)
        self._tokens.put((key, sample.kind == zenoh.SampleKind.PUT), len(key))

    def _take_reply(self, reply: zenoh.Reply) -> None:
        if (sample := reply.ok) is not None:
            self._take_token(sample)

    def _all_told(self) -> None:
        self._tokens.put(None)

    def _on_own_token(self, key: str, alive: bool) -> None:
        self.discovery.apply([(key, alive)])

    def _on_tokens(self, batch: list[tuple[str, bool] | None]) -> None:
        discovery = self.discovery
        before = discovery.malformed + discovery.unlisted
        discovery.apply([item for item in batch if item is not None])
        if refused := discovery.malformed + discovery.unlisted - before:
            self.drops[TOKENS, Undelivered.DECODE] += refused
        if None in batch:
            self._settled = True
        if (lost := self._tokens.lost - self._missed) > 0:
            self._missed = self._tokens.lost
            self.drops[TOKENS, Undelivered.BACKLOG] += lost
            self._ask()

    def _on_changed(self, topics: set[str], services: set[str]) -> None:
        """Let our parts see who is at the other end of their topics and services."""
        if topics:
            self._readers.follow(topics)
        for part in list(self._parts):
            if isinstance(part, ZenohPublisher):
                if part.topic in topics:
                    part.follow()
            elif isinstance(part, ZenohClient | ZenohService) and part.service in services:
                part.follow()
