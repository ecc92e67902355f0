"""The ``dds`` graph: a ROS 2 network reached without ROS, through Cyclone DDS."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Final, TypeVar

from ropeway.errors import GraphUnavailable, InvalidName
from ropeway.graph.actions import ComposedActionClient, ComposedActionServer
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
from ropeway.graph.layout_border import Border
from ropeway.graph.type_answers import offer_descriptions
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
from ropeway.networks.dds.raw import DdsError, lib, load
from ropeway.networks.dds.raw_endpoints import RawWriter
from ropeway.networks.dds.readers import DdsReaders, DdsSubscription, Types
from ropeway.networks.dds.records import Discovered
from ropeway.networks.dds.service import DdsService
from ropeway.networks.dds.service_endpoints import LITTLE_ENDIAN, Ends
from ropeway.networks.dds.vendors import VendorHelper
from ropeway.qos import DEFAULT, QoS, settled
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name

__all__ = ["DdsGraph"]

log = logging.getLogger("ropeway.dds")

# Other vendors do not tell the depth of a writer; what is adopted keeps at least this many.
_MIN_ADOPTED_DEPTH: Final = 10

T = TypeVar("T")
Action = TypeVar("Action", ComposedActionClient, ComposedActionServer)


class DdsGraph(ComposingGraph):
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
        network: TypeRegistry | None = None,
    ) -> None:
        super().__init__(f"dds:{domain}", registry if isinstance(registry, TypeRegistry) else None)
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
        self.helper = helper
        self._fast: FastHelper | None = None
        self._may_be_fast = fast and helper is None
        self.gateway_id = gateway_id
        self._interface = interface
        self._types = registry
        self._clock = clock
        self._foreign = foreign
        self._participant: DdsParticipant | None = None
        self._discovery: DdsDiscovery | None = None
        self._readers: DdsReaders
        self._pairs = 0

    async def _join(self) -> None:
        profile = make_profile(self.name, self._interface)  # refuses a bad interface before anything is waited for
        await asyncio.to_thread(load, self.name)
        if not lib.answers_from_loopback:
            profile = make_profile(self.name, self._interface, answers_from_loopback=False)
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
        self._readers = DdsReaders(self, participant, self._discovery, self._types)
        self._readers.on_closed = self._parts.discard
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
        self._ask_for_types()
        if self.gateway_id and self._registry is not None:
            await offer_descriptions(self._serve_alone, self.node, self._registry)
        log.info("%s: joined as node %s", self.name, self.node)

    async def _close_parts(self) -> None:
        await asyncio.gather(super()._close_parts(), self.participant.withdraw())

    async def _leave(self) -> None:
        if self._fast is not None:
            await self._fast.close()
            self.helper = self._fast = None
        participant, self._participant = self._participant, None
        if participant is not None:
            await participant.close()
        if self._discovery is not None:
            self._discovery.close()
        self._discovery = None

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
        refused, counted = publisher.on_refused, publisher.set_subscribers
        publisher.bind(self._try(lambda: participant.create_writer(names, profile, mark, refused, counted)))
        self._parts.add(publisher)
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
        subscription = DdsSubscription(self._readers, topic, type, qos, self.layouts.reading(topic, type, callback))
        self._readers.begin(subscription)
        self._parts.add(subscription)
        return subscription

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> DdsClient:
        """Call ``service``."""
        client = DdsClient(self, service, type)
        await self._attach(client)
        self._parts.add(client)
        return client

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> DdsService:
        """Serve ``service``; for a failed request nodes get the default response, with its text where it has one."""
        served = DdsService(self, service, type, handler)
        await served.get_help()
        try:
            await self._serve(served)
        except BaseException:
            await served.end_help()
            raise
        return served

    async def _serve_alone(self, service: str, type: str, handler: ServiceHandler) -> None:
        """Serve what nodes of other middlewares seldom call: no helper is started for it."""
        await self._serve(DdsService(self, service, type, handler))

    async def _serve(self, served: DdsService) -> None:
        await self._attach(served)
        self._parts.add(served)

    def topics(self) -> dict[str, TopicInfo]:
        """Return every ROS topic in the domain, ours included."""
        return self._discovery.topics() if self._discovery else {}

    def services(self) -> dict[str, ServiceInfo]:
        """Return every service in the domain, ours included; those of other middlewares are listed like the rest."""
        return self._discovery.services() if self._discovery else {}

    def actions(self) -> dict[str, ActionInfo]:
        """Return every action in the domain, ours included."""
        return self._discovery.actions() if self._discovery else {}

    def counts(self) -> tuple[int, int]:
        """See ``Graph.counts``."""
        return self._discovery.counts() if self._discovery else (0, 0)

    def count_publishers(self, topic: str) -> tuple[int, int]:
        """See ``Graph.count_publishers``."""
        return self._discovery.count_publishers(topic) if self._discovery else (0, 0)

    def look_up(self, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None:
        """See ``Graph.look_up``."""
        return self._discovery.look_up(kind, name) if self._discovery else None

    def types_of(self, kind: str, name: str) -> tuple[str, ...]:
        """See ``Graph.types_of``."""
        return self._discovery.types_of(kind, name) if self._discovery else ()

    def nodes(self) -> dict[str, NodeInfo]:
        """Return every ROS node in the domain, ours included."""
        return self._discovery.nodes() if self._discovery else {}

    @property
    def settled(self) -> bool:
        """Whether every participant that was discovered has announced its nodes; Fast DDS may take some seconds."""
        return self._discovery is None or self._discovery.settled

    @property
    def distro(self) -> str:
        """See ``Distributed``."""
        return self.layouts.distro

    @property
    def participant(self) -> DdsParticipant:
        """The DDS side, for services and actions. Raises ``GraphUnavailable`` where the graph is not open."""
        return self._opened()

    # For the parts ----------------------------------------------------------------------------------------------

    async def withdraw(self, publisher: DdsPublisher, writer: RawWriter | None) -> None:
        """Remove a closed publisher."""
        self._parts.discard(publisher)
        if writer is not None and self._participant is not None:
            await self._participant.delete(writer)

    async def remove(self, part: Ends) -> None:
        """Remove a closed client or service."""
        self._parts.discard(part)
        if self._participant is not None:
            await part.leave(self._participant)

    def node_of(self, guid: bytes) -> str:
        """Return the full name of the node that an endpoint belongs to, or ``""``."""
        return self._discovery.node_of(guid) if self._discovery else ""

    def type_hash(self, type: str) -> str:
        """Return ``RIHS01_…`` if the registry knows the type, or ``""``."""
        registry = self.layouts.registry or self._types
        return registry.hash(type) if registry is not None and registry.has(type) else ""

    def little_endian(self, type: str, payload: bytes) -> bytes:
        """Convert CDR of ``type`` to our byte order. Raises ``DecodeError``, ``UnknownType``."""
        if payload[1] == LITTLE_ENDIAN:
            return payload
        codec = self.registry.codec(type)
        return codec.encode(codec.decode(payload))

    # DdsDiscovery --------------------------------------------------------------------------------------------------

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
        self._readers.readopt(topics)

    def _opened(self) -> DdsParticipant:
        if self._participant is None:
            raise GraphUnavailable(self.name, "is not open; call open() first")
        return self._participant

    async def _attach(self, part: Ends) -> None:
        participant = self._opened()
        self._pairs += 1
        pair = participant.guid[:12] + self._pairs.to_bytes(4, "big")
        try:
            await part.join(participant, pair.hex("."))
        except DdsError as error:
            raise GraphUnavailable(self.name, str(error)) from error

    def _try(self, create: Callable[[], T]) -> T:
        try:
            return create()
        except DdsError as error:
            raise GraphUnavailable(self.name, str(error)) from error
