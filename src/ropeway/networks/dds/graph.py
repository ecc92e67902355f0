"""The ``dds`` graph: a ROS 2 network reached without ROS, through Cyclone DDS."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from typing import Final, Protocol, TypeVar

from ropeway.errors import GraphUnavailable, InvalidName
from ropeway.graph.actions import ComposedActionClient, ComposedActionServer
from ropeway.graph.base import (
    NO_HINTS,
    Changes,
    Delivery,
    GraphEvent,
    NodeInfo,
    SampleCallback,
    TopicInfo,
    Undelivered,
    resolve_name,
)
from ropeway.graph.calls import ActionHandlers, ActionInfo, ServiceHandler, ServiceInfo
from ropeway.graph.layout_border import Border
from ropeway.logs import failed
from ropeway.networks.dds.byteorder import ByteOrder, Codec
from ropeway.networks.dds.client import DdsClient
from ropeway.networks.dds.discovery import DdsDiscovery
from ropeway.networks.dds.domain import MAX_DOMAIN
from ropeway.networks.dds.endpoint_qos import user_data
from ropeway.networks.dds.fastdds import FAST, FastHelper, FastRpc, Surroundings
from ropeway.networks.dds.layouts import Layouts
from ropeway.networks.dds.names import dds_topic, dds_type
from ropeway.networks.dds.participant import DdsParticipant
from ropeway.networks.dds.profile import make_profile
from ropeway.networks.dds.publisher import DdsPublisher
from ropeway.networks.dds.raw import DdsError
from ropeway.networks.dds.raw_endpoints import RawWriter
from ropeway.networks.dds.records import Discovered
from ropeway.networks.dds.service import DdsService
from ropeway.networks.dds.service_endpoints import Ends
from ropeway.networks.dds.subscription import DdsSubscription, SharedReader, settled
from ropeway.networks.dds.vendors import VendorHelper
from ropeway.qos import DEFAULT, QoS, common_qos
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name
from ropeway.types.variant import Variant

__all__ = ["DdsGraph", "Types"]

log = logging.getLogger("ropeway.dds")

# Other vendors do not tell the depth of a writer; what is adopted keeps at least this many.
_MIN_ADOPTED_DEPTH: Final = 10
_LITTLE_ENDIAN: Final = 1

T = TypeVar("T")
Action = TypeVar("Action", ComposedActionClient, ComposedActionServer)


class Types(Protocol):
    """The part of a type registry that is used here."""

    def has(self, name: str) -> bool:
        """Return whether the definition is known."""

    def hash(self, name: str) -> str:
        """Return ``RIHS01_…``, which ``ros2 topic info -v`` shows."""

    def codec(self, name: str) -> Codec:
        """Return the codec that tells big-endian messages from others."""


class DdsGraph:
    """A participant of DDS domain ``domain``, seen by ROS 2 as the node ``namespace``/``name``.

    ``interface`` is the name or address of a network interface (``None``: Cyclone DDS chooses; ``lo`` stays on this
    machine). ``gateway_id`` marks our publishers, so that other processes of the same gateway ignore them and other
    gateways know them. ``registry`` gives type hashes, and finds big-endian messages, where it knows the type.
    ``foreign`` lists topics that are not of ROS, too. ``clock`` gives nanoseconds for ``Sample.stamp_ns``. Services are
    those of rmw_cyclonedds; those of other middlewares are left to a ``helper``: without one, ``fast`` says whether
    Fast DDS nodes are served and called in a process of its own, which starts when it is needed. ``network`` has the
    types of this network where they are known not to be those of ``registry``.
    """

    kind = "dds"

    def __init__(
        self,
        domain: int = 0,
        *,
        name: str = "ropeway",
        namespace: str = "/",
        interface: str | None = None,
        gateway_id: str = "",
        registry: Types | None = None,
        clock: Callable[[], int] = time.time_ns,
        foreign: bool = False,
        helper: VendorHelper | None = None,
        fast: bool = True,
        network: Variant | None = None,
    ) -> None:
        self.name = f"dds:{domain}"
        self.layouts = Layouts(
            self.name,
            Border(registry, network),
            lambda: self._discovery,
            lambda: self._participant is not None and self._participant.is_old,
        )
        if not 0 <= domain <= MAX_DOMAIN:
            raise GraphUnavailable(self.name, f"the domain must be a number from 0 to {MAX_DOMAIN}")
        if any(c in gateway_id for c in ";="):
            raise GraphUnavailable(self.name, f"the gateway id {gateway_id!r} has a ';' or '='")
        if "/" in name:
            raise InvalidName(name, "a node name has no slash; give the namespace apart")
        self.domain = domain
        self.node = resolve_name(name, namespace)
        self.drops: Counter[tuple[str, Undelivered]] = Counter()
        self.helper = helper
        self._fast: FastHelper | None = None
        self._may_be_fast = fast and helper is None
        self.gateway_id = gateway_id
        self._interface = interface
        self._registry = registry
        self._clock = clock
        self._foreign = foreign
        self._changes = Changes()
        self._participant: DdsParticipant | None = None
        self._discovery: DdsDiscovery | None = None
        self._publishers: dict[DdsPublisher, None] = {}
        self._subscriptions: dict[DdsSubscription, None] = {}
        self._shared: dict[tuple[str, str, QoS], SharedReader] = {}
        self._clients: dict[DdsClient, None] = {}
        self._services: dict[DdsService, None] = {}
        self._pairs = 0
        self._actions: list[ComposedActionClient | ComposedActionServer] = []
        self._own_registry: TypeRegistry | None = None
        self._lock = asyncio.Lock()

    async def open(self) -> None:
        """Join the domain. Raises ``GraphUnavailable`` with what to do."""
        async with self._lock:
            if self._participant is not None:
                return
            profile = make_profile(self.name, self._interface)
            self._changes = Changes()
            participant = DdsParticipant(
                self.name, self.domain, profile, self.node, self.gateway_id, self._clock, self._on_discovered
            )
            self._discovery = DdsDiscovery(
                self.name,
                self.gateway_id,
                self._changes.emit,
                self._readopt,
                participant.follow_gid_bytes,
                foreign=self._foreign,
            )
            try:
                await participant.open()
            except DdsError as error:
                self._discovery = None
                raise GraphUnavailable(self.name, str(error)) from error
            except BaseException:
                self._discovery = None
                raise
            self._participant = participant
            if self._may_be_fast:
                around = Surroundings(
                    self.little_endian, self.type_hash, self.node_of, self._count_drops, self._fast_endpoints
                )
                rpc = FastRpc(self.name, self.domain, profile, gateway_id=self.gateway_id, around=around)
                self.helper = self._fast = FastHelper(rpc, participant)
            log.info("%s: joined as node %s", self.name, self.node)

    async def close(self) -> None:
        """Leave the domain with everything that was created here."""
        async with self._lock:
            participant = self._participant
            if participant is None:
                return
            await asyncio.gather(*(action.close() for action in self._actions))
            self._actions.clear()
            parts: list[DdsPublisher | DdsSubscription | DdsClient | DdsService]
            parts = [*self._clients, *self._services, *self._publishers, *self._subscriptions]
            await asyncio.gather(*(part.close() for part in parts), participant.withdraw())
            if self._fast is not None:
                await self._fast.close()
                self.helper = self._fast = None
            self._participant = None
            await participant.close()
            self._shared.clear()
            if self._discovery is not None:
                self._discovery.close()
            self._discovery = None
            self._changes.close()

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> DdsPublisher:
        """Publish ``topic``; without a profile, reliable and volatile. DDS has its own way with ``delivery``."""
        participant = self._opened()
        topic, type = resolve_name(topic), canonical_name(type)
        profile = settled(qos or DEFAULT, DEFAULT)
        publisher = DdsPublisher(self, topic, type, profile, self.layouts.writing(topic, type))
        mark = user_data(type_hash=self.type_hash(type), gateway_id=self.gateway_id)
        names = (dds_topic(topic), dds_type(type))
        publisher.bind(
            self._try(lambda: participant.create_writer(names, profile, mark, publisher.on_refused, publisher.on_count))
        )
        self._publishers[publisher] = None
        return publisher

    async def create_subscription(
        self,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> DdsSubscription:
        """Read ``topic``; without a profile, with what all its publishers offer, also when they change."""
        self._opened()
        topic, type = resolve_name(topic), canonical_name(type)
        subscription = DdsSubscription(self, topic, type, qos, self.layouts.reading(topic, type, callback))
        subscription.follow(self._adopted(subscription))
        self._subscriptions[subscription] = None
        return subscription

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> DdsClient:
        """Call ``service``."""
        client = DdsClient(self, service, type)
        await self._join(client)
        self._clients[client] = None
        return client

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> DdsService:
        """Serve ``service``; for a failed request nodes get the default response, with its text where it has one."""
        served = DdsService(self, service, type, handler)
        await served.get_help()
        try:
            await self._join(served)
        except BaseException:
            await served.end_help()
            raise
        self._services[served] = None
        return served

    async def create_action_client(
        self, action: str, type: str, *, delivery: Delivery = NO_HINTS
    ) -> ComposedActionClient:
        """Use ``action``. Raises ``UnknownType`` without its definition."""
        self._opened()
        return await self._start(ComposedActionClient(self, action, type, self.registry))

    async def create_action_server(
        self, action: str, type: str, handlers: ActionHandlers, *, delivery: Delivery = NO_HINTS
    ) -> ComposedActionServer:
        """Serve ``action``. Raises ``UnknownType`` without its definition."""
        self._opened()
        return await self._start(ComposedActionServer(self, action, type, handlers, self.registry))

    def topics(self) -> dict[str, TopicInfo]:
        """Return every ROS topic in the domain, ours included."""
        return self._discovery.topics() if self._discovery else {}

    def services(self) -> dict[str, ServiceInfo]:
        """Return every service in the domain, ours included; those of other middlewares are listed like the rest."""
        return self._discovery.services() if self._discovery else {}

    def actions(self) -> dict[str, ActionInfo]:
        """Return every action in the domain, ours included."""
        return self._discovery.actions() if self._discovery else {}

    def look_up(self, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None:
        """See ``ropeway.graph.base.look_up``."""
        return self._discovery.look_up(kind, name) if self._discovery else None

    def types_of(self, kind: str, name: str) -> tuple[str, ...]:
        """See ``ropeway.graph.base.types_of``."""
        return self._discovery.types_of(kind, name) if self._discovery else ()

    def nodes(self) -> dict[str, NodeInfo]:
        """Return every ROS node in the domain, ours included."""
        return self._discovery.nodes() if self._discovery else {}

    def changes(self) -> AsyncIterator[GraphEvent]:
        """Iterate over what others do, from now on."""
        return self._changes.listen()

    @property
    def settled(self) -> bool:
        """Whether every participant that was discovered has announced its nodes; Fast DDS may take some seconds."""
        return self._discovery is None or self._discovery.settled

    @property
    def distro(self) -> str:
        """See ``Distributed``."""
        return self.layouts.distro

    @property
    def registry(self) -> TypeRegistry:
        """The definitions that actions, and responses to failed requests, are made with."""
        if isinstance(self._registry, TypeRegistry):
            return self._registry
        if self._own_registry is None:
            self._own_registry = TypeRegistry()
        return self._own_registry

    @property
    def participant(self) -> DdsParticipant:
        """The DDS side, for services and actions. Raises ``GraphUnavailable`` where the graph is not open."""
        return self._opened()

    # For the parts ----------------------------------------------------------------------------------------------

    def guard(self, topic: str, callback: Callable[[T], None], value: T) -> None:
        """Run a callback that may fail."""
        try:
            callback(value)
        except Exception:  # a callback is somebody else's code; the others must not suffer
            self.drops[topic, Undelivered.CALLBACK] += 1
            failed(log, "%s: a callback for %s failed", self.name, topic)

    def attach(self, subscription: DdsSubscription, qos: QoS) -> SharedReader:
        """Return a reader for ``subscription``: shared if samples are volatile, its own if history is replayed."""
        participant = self._opened()
        key = (subscription.topic, subscription.type, qos)
        reader = None if qos.transient_local else self._shared.get(key)
        if reader is None:
            made = reader = SharedReader(self, subscription.topic, qos)
            mark = user_data(type_hash=self.type_hash(subscription.type), gateway_id=self.gateway_id)
            names = (dds_topic(subscription.topic), dds_type(subscription.type))
            order = self._byte_order(subscription.topic, subscription.type)
            made.raw = self._try(
                lambda: participant.create_reader(
                    names, subscription.type, qos, mark, made.deliver, made.dropped, order
                )
            )
            if not qos.transient_local:
                self._shared[key] = reader
        reader.subscriptions = (*reader.subscriptions, subscription)
        return reader

    async def detach(self, subscription: DdsSubscription, reader: SharedReader) -> None:
        """Take a subscription off its reader; the last one takes the reader with it."""
        reader.subscriptions = tuple(s for s in reader.subscriptions if s is not subscription)
        if reader.subscriptions:
            return
        key = (reader.topic, subscription.type, reader.qos)
        if self._shared.get(key) is reader:
            del self._shared[key]
        if self._participant is not None and reader.raw is not None:
            await self._participant.delete(reader.raw)

    def forget(self, subscription: DdsSubscription) -> None:
        """Release what belongs to a closed subscription."""
        self._subscriptions.pop(subscription, None)

    def is_matched(self, subscription: DdsSubscription, reader: SharedReader) -> bool:
        """Return whether a reader is matched with every publisher that it should read."""
        if self._participant is None or self._discovery is None or reader.raw is None:
            return True
        expected = len(self._discovery.offered(subscription.topic, subscription.type))
        return self._participant.matched_writers(reader.raw) >= expected

    async def withdraw(self, publisher: DdsPublisher, writer: RawWriter | None) -> None:
        """Remove a closed publisher."""
        self._publishers.pop(publisher, None)
        if writer is not None and self._participant is not None:
            await self._participant.delete(writer)

    async def remove(self, part: DdsClient | DdsService) -> None:
        """Remove a closed client or service."""
        self._clients.pop(part, None) if isinstance(part, DdsClient) else self._services.pop(part, None)
        if self._participant is not None:
            await part.leave(self._participant)

    def node_of(self, guid: bytes) -> str:
        """Return the full name of the node that an endpoint belongs to, or ``""``."""
        return self._discovery.node_of(guid) if self._discovery else ""

    def type_hash(self, type: str) -> str:
        """Return ``RIHS01_…`` if the registry knows the type, or ``""``."""
        registry = self.layouts.registry or self._registry
        return registry.hash(type) if registry is not None and registry.has(type) else ""

    def little_endian(self, type: str, payload: bytes) -> bytes:
        """Convert CDR of ``type`` to our byte order. Raises ``DecodeError``, ``UnknownType``."""
        if payload[1] == _LITTLE_ENDIAN:
            return payload
        codec = self.registry.codec(type)
        return codec.encode(codec.decode(payload))

    # Discovery --------------------------------------------------------------------------------------------------

    def _on_discovered(self, batch: list[Discovered]) -> None:
        if self._discovery is not None:
            self._discovery.apply(batch)
        if self._fast is not None:
            self._fast.on_discovered(batch)

    def _fast_endpoints(self) -> list[bytes]:
        return self._discovery.guids(FAST) if self._discovery is not None else []

    def _count_drops(self, name: str, reason: Undelivered, count: int) -> None:
        self.drops[name, reason] += count

    def _readopt(self, topics: set[str]) -> None:
        for subscription in list(self._subscriptions):
            if subscription.adopts and subscription.topic in topics:
                try:
                    subscription.follow(self._adopted(subscription))
                except GraphUnavailable as error:
                    log.warning("%s: %s keeps its profile: %s", self.name, subscription.topic, error)

    def _adopted(self, subscription: DdsSubscription) -> QoS:
        """Return the profile that a subscription should have now."""
        asked = subscription.asked
        if asked is not None and not subscription.adopts:
            return asked
        assert self._discovery is not None
        offered = self._discovery.offered(subscription.topic, subscription.type)
        qos = common_qos(offered, subscription.qos)
        if asked is not None:
            return settled(asked, qos)
        if qos.history == "keep_last" and not qos.transient_local:
            qos = replace(qos, depth=max(qos.depth, _MIN_ADOPTED_DEPTH))
        return qos

    def _opened(self) -> DdsParticipant:
        if self._participant is None:
            raise GraphUnavailable(self.name, "is not open; call open() first")
        return self._participant

    async def _join(self, part: Ends) -> None:
        participant = self._opened()
        self._pairs += 1
        pair = participant.guid[:12] + self._pairs.to_bytes(4, "big")
        try:
            await part.join(participant, pair.hex("."))
        except DdsError as error:
            raise GraphUnavailable(self.name, str(error)) from error

    async def _start(self, action: Action) -> Action:
        await action.open()
        self._actions = [*(known for known in self._actions if not known.closed), action]
        return action

    def _byte_order(self, topic: str, type: str) -> ByteOrder | None:
        registry = self._registry
        if registry is None or not registry.has(type):
            return None
        return ByteOrder(f"{self.name}: {topic}", lambda: registry.codec(type))

    def _try(self, create: Callable[[], T]) -> T:
        try:
            return create()
        except DdsError as error:
            raise GraphUnavailable(self.name, str(error)) from error
