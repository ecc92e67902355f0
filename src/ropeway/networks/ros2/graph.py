"""The ``ros2`` graph: a ROS 2 network through the rclpy of the sourced environment."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, Final, TypeVar

from ropeway.errors import GraphUnavailable, InvalidName, UnknownType
from ropeway.graph.base import (
    NO_HINTS,
    Delivery,
    NodeInfo,
    SampleCallback,
    TopicInfo,
    resolve_name,
)
from ropeway.graph.calls import ProviderInfo, ServiceHandler, ServiceInfo
from ropeway.graph.graph_base import ComposingGraph
from ropeway.graph.layout_border import Border
from ropeway.graph.type_answers import offer_descriptions
from ropeway.networks.ros2.client import Ros2Client
from ropeway.networks.ros2.discovery import Ros2Discovery
from ropeway.networks.ros2.environment import MAX_DOMAIN
from ropeway.networks.ros2.interfaces import loaded, message_class, service_class
from ropeway.networks.ros2.origins import Origins
from ropeway.networks.ros2.participant import Ros2Participant
from ropeway.networks.ros2.profiles import service_profile, writer_profile
from ropeway.networks.ros2.publisher import Ros2Publisher
from ropeway.networks.ros2.readers import Ros2Readers, Ros2Subscription
from ropeway.networks.ros2.senders import Lane
from ropeway.networks.ros2.service import Ros2Service
from ropeway.networks.ros2.snapshot import Ros2Snapshot
from ropeway.qos import DEFAULT, QoS, settled
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name

__all__ = ["Ros2Graph", "Ros2Subscription"]

log = logging.getLogger("ropeway.ros2")

# Matching has no signal in every distribution: it is looked at so long after each change, and then every second.
_LOOK_S: Final = (0.02, 0.05, 0.1, 0.25, 0.5)
_LOOK_LATER_S: Final = 1.0


T = TypeVar("T")
_Part = Ros2Publisher | Ros2Subscription | Ros2Client | Ros2Service


class Ros2Graph(ComposingGraph):
    """The node ``namespace``/``name`` in domain ``domain``.

    ``gateway_id`` names the gateway that it belongs to: its processes do not hear each other. ``registry`` knows the
    types of actions; left out, those of ROS 2 and of the sourced environment.
    """

    kind = "ros2"

    def __init__(
        self,
        domain: int = 0,
        *,
        name: str = "ropeway",
        namespace: str = "/",
        gateway_id: str = "",
        registry: TypeRegistry | None = None,
    ) -> None:
        super().__init__(f"ros2:{domain}", registry)
        if not 0 <= domain <= MAX_DOMAIN:
            raise GraphUnavailable(self.name, f"the domain must be a number from 0 to {MAX_DOMAIN}")
        if "/" in name:
            raise InvalidName(name, "a node name has no slash; give the namespace apart")
        self.domain = domain
        self.node = resolve_name(name, namespace)
        self._gateway_id = gateway_id
        self._participant: Ros2Participant | None = None
        self._discovery: Ros2Discovery
        self._origins: Origins
        self._readers: Ros2Readers
        self._look_at: asyncio.TimerHandle | None = None
        self._looks = 0

    async def _join(self) -> None:
        participant = Ros2Participant(self.name, self.domain, self.node, self._gateway_id)
        self._discovery = Ros2Discovery(self.name, self._gateway_id, self._changes.emit, self._readopt)
        await participant.open(self._on_picture)
        self._origins = Origins(participant.rmw, self._discovery)
        self._readers = Ros2Readers(self, participant, self._discovery, self._origins)
        self._readers.on_closed = self._parts.discard
        self._participant = participant
        self._ask_for_types()
        if self._gateway_id:
            with contextlib.suppress(UnknownType):  # Humble has no such service
                await offer_descriptions(self.create_service, self.node, self.registry)
        log.info("%s: joined as node %s over %s", self.name, self.node, participant.rmw)

    async def _leave(self) -> None:
        participant, self._participant = self._participant, None
        if self._look_at is not None:
            self._look_at.cancel()
            self._look_at = None
        if participant is not None:
            await participant.close()

    # Topics -----------------------------------------------------------------------------------------------------

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> Ros2Publisher:
        """Publish ``topic``; without a profile, reliable and volatile. ROS has its own way with ``delivery``."""
        participant = self.participant
        topic, type = resolve_name(topic), canonical_name(type)
        cls = await loaded(message_class, type)
        profile = settled(qos or DEFAULT, DEFAULT)
        self._check_open()
        raw = self.attempt(lambda: participant.node.create_publisher(cls, topic, writer_profile(profile)))
        publisher = Ros2Publisher(self, topic, type, profile, raw)
        with raw.handle:
            self._origins.add_own(self.attempt(lambda: participant.rcl.gid_of(raw.handle.pointer)))
        self._add(publisher)
        return publisher

    async def create_subscription(
        self,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> Ros2Subscription:
        """Read ``topic``; without a profile, with what all its publishers offer, also when they change."""
        self._check_open()
        topic, type = resolve_name(topic), canonical_name(type)
        await loaded(message_class, type)
        self._check_open()
        subscription = Ros2Subscription(self._readers, topic, type, qos, callback)
        self._readers.begin(subscription)
        self._add(subscription)
        return subscription

    def topics(self) -> dict[str, TopicInfo]:
        """Return every topic in the domain, ours included; those that belong to actions stand under ``actions``."""
        return self._discovery.topics() if self._participant is not None else {}

    # Services and actions ---------------------------------------------------------------------------------------

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> Ros2Client:
        """Call ``service``; ROS has its own way with ``delivery``."""
        participant = self.participant
        service, type = resolve_name(service), canonical_name(type, "srv")
        cls = await loaded(service_class, type)
        self._check_open()
        raw = self.attempt(lambda: participant.node.create_client(cls, service, qos_profile=service_profile()))
        client = Ros2Client(self, service, type, raw, cls)
        participant.spinner.add("client", raw.handle, client.take)
        self._add(client)
        return client

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> Ros2Service:
        """Serve ``service``; ROS has its own way with ``delivery``."""
        participant = self.participant
        service, type = resolve_name(service), canonical_name(type, "srv")
        cls = await loaded(service_class, type)
        self._check_open()
        raw = self.attempt(lambda: participant.node.create_service(cls, service, _never, qos_profile=service_profile()))
        served = Ros2Service(self, service, type, handler, raw, cls)
        participant.spinner.add("service", raw.handle, served.take)
        self._add(served)
        return served

    @cached_property
    def border(self) -> Border:
        """The border at which messages get the layouts of the sourced ROS 2, whatever distribution they come from."""
        return Border(self.registry)

    @property
    def registry(self) -> TypeRegistry:
        """Return the types that actions are made of; unless some were given, those of the sourced ROS 2."""
        if self._registry is None:
            self._registry = TypeRegistry()
            self._registry.add_ament_prefix_path()
        return self._registry

    def services(self) -> dict[str, ServiceInfo]:
        """Return every service in the domain, ours included."""
        if self._participant is None:
            return {}
        found = {
            name: replace(info, servers=_of_others(info.servers), clients=_of_others(info.clients))
            for name, info in self._discovery.services().items()
        }
        us = ProviderInfo(self.node, local=True)
        for part in self._parts:
            if isinstance(part, Ros2Service | Ros2Client):
                info = found.get(part.service) or ServiceInfo(part.service, ())
                info = replace(info, types=tuple(dict.fromkeys((*info.types, part.type))))
                if isinstance(part, Ros2Service):
                    found[part.service] = replace(info, servers=(*info.servers, us))
                else:
                    found[part.service] = replace(info, clients=(*info.clients, us))
        return {name: info for name, info in sorted(found.items()) if info.servers or info.clients}

    def nodes(self) -> dict[str, NodeInfo]:
        """Return every node in the domain, ours included."""
        return self._discovery.nodes() if self._participant is not None else {}

    @property
    def settled(self) -> bool:
        """Whether the network was polled, and the nodes of all endpoints are known."""
        return self._participant is None or self._discovery.settled

    @property
    def participant(self) -> Ros2Participant:
        """The side of rclpy. Raises ``GraphUnavailable`` where the graph is not open."""
        if self._participant is None:
            raise GraphUnavailable(self.name, "is not open; call open() first")
        return self._participant

    # For the parts ----------------------------------------------------------------------------------------------

    def attempt(self, create: Callable[[], T]) -> T:
        """Do something with rclpy. Raises ``GraphUnavailable`` with what it says."""
        try:
            return create()
        except (RuntimeError, ValueError) as error:
            raise GraphUnavailable(self.name, str(error).splitlines()[0]) from error

    def count_readers(self, publisher: Ros2Publisher) -> int:
        """Return how many readers of others are matched with a publisher."""
        return self._readers.count_others(publisher) if self._participant is not None else 0

    async def withdraw(self, publisher: Ros2Publisher, lane: Lane) -> None:
        """Remove a closed publisher."""
        self._parts.discard(publisher)
        if self._participant is not None:
            await lane.finish(lambda: self._destroy("publisher", publisher.raw))
            self.look_soon()

    async def remove(self, part: Ros2Client | Ros2Service, raw: Any, lane: Lane) -> None:
        """Remove a closed client or service."""
        self._parts.discard(part)
        if self._participant is not None:
            self._participant.spinner.remove(raw.handle)
            kind = "client" if isinstance(part, Ros2Client) else "service"
            await lane.finish(lambda: self._destroy(kind, raw))
            self.look_soon()

    def _destroy(self, kind: str, raw: Any) -> None:
        """Destroy an entity, in a thread."""
        participant = self._participant
        if participant is not None and participant.node is not None:
            getattr(participant.node, f"destroy_{kind}")(raw)

    # Ros2Discovery --------------------------------------------------------------------------------------------------

    def _on_picture(self, picture: Ros2Snapshot) -> None:
        if self._participant is not None:
            self._discovery.apply(picture)
            self._look()

    def look_soon(self) -> None:
        """Poll the network at once, and the matches in a moment, after a change here."""
        if self._participant is not None:
            self._participant.watcher.poke()
            self._looks = 0
            self._arm()

    def _arm(self) -> None:
        if self._look_at is not None:
            self._look_at.cancel()
        pause = _LOOK_S[self._looks] if self._looks < len(_LOOK_S) else _LOOK_LATER_S
        self._look_at = asyncio.get_running_loop().call_later(pause, self._look_again)

    def _look_again(self) -> None:
        self._look_at = None
        self._looks += 1
        self._look_at_matches()
        self._arm()

    def _look(self) -> None:
        self._look_at_matches()
        self._looks = 0
        self._arm()

    def _look_at_matches(self) -> None:
        for part in list(self._parts):
            if isinstance(part, Ros2Publisher | Ros2Client):
                part.look()

    def _readopt(self, topics: set[str]) -> None:
        self._readers.readopt(topics)

    def _add(self, part: _Part) -> None:
        self._parts.add(part)
        self.look_soon()

    def _check_open(self) -> None:
        _ = self.participant


def _of_others(providers: tuple[ProviderInfo, ...]) -> tuple[ProviderInfo, ...]:
    return tuple(provider for provider in providers if not provider.local)


def _never(*_: object) -> None:
    """Satisfy rclpy, which asks for a callback; no executor that would call it ever sees our node."""
