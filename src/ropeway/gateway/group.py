"""A remote that is a group: several gateways or rosbridge servers, or members of the overlay, that offer the same."""

from __future__ import annotations

import logging
import struct
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import RopewayError
from ropeway.gateway.config.group_hints import remote_hints
from ropeway.gateway.config.group_model import AnycastConfig
from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.config.policy import policies_of
from ropeway.gateway.config.route_model import OPERATIONS
from ropeway.gateway.credentials import Credentials
from ropeway.gateway.group_commands import GroupCommands
from ropeway.gateway.group_services import GroupServices
from ropeway.gateway.group_states import GroupStates
from ropeway.gateway.remote import NO_CREDENTIALS, Remote, SeveralLinks, overlay_state, shown_address
from ropeway.graph.base import Graph, Sample, Subscription
from ropeway.group.graph import Group
from ropeway.group.state_lease import StateLease
from ropeway.networks.rosbridge.client import RosbridgeGraph
from ropeway.types import TypeRegistry

if TYPE_CHECKING:
    from ropeway.networks.overlay.graph import OverlayGraph

__all__ = ["GroupRemote", "LinkGroupRemote", "OverlayGroupRemote"]

log = logging.getLogger("ropeway.group")

_LATENCY_TYPE: Final = "std_msgs/msg/Float64"
_LATENCY: Final = struct.Struct("<d")
_LATENCY_AT: Final = 4  # behind the header of CDR


class GroupRemote(Remote):
    """Several machines as one graph. ``options`` say who they are, as ``Group`` takes it."""

    graph: Group
    listens = True

    def __init__(
        self,
        config: RemoteConfig,
        registry: TypeRegistry,
        gateway: str,
        credentials: Credentials = NO_CREDENTIALS,
        **options: Any,
    ) -> None:
        super().__init__(config, credentials)
        anycast = config.anycast or AnycastConfig.model_validate({})
        title, policies = config.title or shown_address(config), policies_of(config, gateway)
        for path, hint in remote_hints(config):
            log.warning("%s: anycast.%s: %s", title, path, hint)
        self.states = GroupStates(policies, self, registry, group=title)
        self.graph = Group(
            name=title,
            exchanges=anycast.pairs,
            registry=registry,
            first=self.states.first,
            barred=self.states.barred,
            **anycast.group_options(),
            **options,
        )
        self.graph.pairs.crosses(_topics(config))
        self.graph.on_decision = self.states.changed
        self.commands = GroupCommands(self.graph, dict(policies.machines))
        self._services = GroupServices(self.commands, registry, f"/{gateway}/anycast") if config.anycast else None
        self._latency_topic = anycast.latency_topic
        self._latencies: Subscription | None = None

    async def crosses(self, config: RemoteConfig) -> None:
        """See ``Remote.crosses``: topics that are asked and answered may have other names at the members now."""
        self.graph.pairs.crosses(_topics(config))

    async def listen(self, view: Graph) -> None:
        """Begin with what the local graph has to do with the group: services for nodes, parameters, latencies."""
        self.states.start(view)
        if self._services is not None:
            try:
                await self._services.open(view)
            except RopewayError as error:  # another group has the names, or the graph takes no services
                log.warning("%s: no services for nodes: %s", self.graph.name, error)
        if self._latency_topic is not None:
            self._latencies = await view.create_subscription(self._latency_topic, _LATENCY_TYPE, None, self._measured)

    async def close(self) -> None:
        """End it."""
        if self._services is not None:
            await self._services.close()
        await self.states.close()
        if self._latencies is not None:
            await self._latencies.close()

    def _measured(self, batch: Sequence[Sample]) -> None:
        scheduler = self.graph.scheduler
        for sample in batch:
            if scheduler.current and len(sample.payload) >= _LATENCY_AT + _LATENCY.size:
                (latency_s,) = _LATENCY.unpack_from(sample.payload, _LATENCY_AT)
                if latency_s >= 0:  # no latency is negative, and NaN is none
                    scheduler.measured(scheduler.current, latency_s, self.graph.now())

    def status(self) -> dict[str, Any]:
        """Return the state of the group, for people and programs."""
        return {
            "address": shown_address(self.config),
            "title": self.config.title,
            "state": self.state,
            "error": self.error,
            "group": self.graph.status() | {"states": self.states.status()},
        }

    def machines(self) -> Mapping[str, Graph]:
        """Return the members that are reached, by name."""
        return self.graph.reached()

    def tell_state(self, name: str, state: str) -> None:
        """Tell the gateway of a member its state, if it takes that."""
        raise NotImplementedError

    @property
    def current(self) -> str:
        """The member in use."""
        return self.graph.scheduler.current

    @property
    def error(self) -> str:
        """The reason why members are not reached, ``""`` where there is none."""
        raise NotImplementedError


class LinkGroupRemote(SeveralLinks, GroupRemote):
    """Several addresses as one graph; its members are called by their addresses."""

    def __init__(
        self,
        config: RemoteConfig,
        links: Mapping[str, RosbridgeGraph],
        registry: TypeRegistry,
        credentials: Credentials,
        gateway: str,
    ) -> None:
        self.links = dict(links)
        super().__init__(config, registry, gateway, credentials, members=links)

    def status(self) -> dict[str, Any]:
        """Return the state of the group and its links, for people and programs."""
        return {**super().status(), "members": self.members("address")}

    def machines(self) -> Mapping[str, Graph]:
        """Return the links whose far side is reached."""
        return {name: link for name, link in self.links.items() if link.peer is not None}

    def tell_state(self, name: str, state: str) -> None:
        """Tell the gateway there its state, if it is one that takes it."""
        peer = self.links[name].peer
        if peer is not None and peer.takes_states:
            peer.send(StateLease.message(self.graph.name, state))


class OverlayGroupRemote(GroupRemote):
    """The members of the overlay that offer the same, as one graph; they are called by the names in their
    certificates.
    """

    def __init__(
        self,
        config: RemoteConfig,
        overlay: OverlayGraph,
        registry: TypeRegistry,
        gateway: str,
    ) -> None:
        from ropeway.networks.overlay.graph.pool import OverlayPool  # loads Zenoh, which other groups do not need

        assert config.anycast is not None
        self._pool = OverlayPool(overlay, config.anycast.members or ("*",))
        super().__init__(config, registry, gateway, members={}, roster=self._pool)
        self.overlay = overlay
        self._take_answers()

    async def crosses(self, config: RemoteConfig) -> None:
        """See ``Remote.crosses``: members are told on which topic answers are expected."""
        changed = self.graph.pairs.crosses(_topics(config))
        self._take_answers()
        await self.graph.announce_anew(changed)

    def _take_answers(self) -> None:
        pairs = self.graph.pairs
        self._pool.answers.clear()
        self._pool.answers.update({topic: pairs.answers(topic) for topic in pairs.asked()})

    def tell_state(self, name: str, state: str) -> None:
        """Tell the gateway there its state, over the sealed channel to it."""
        member = self._pool.members().get(name)
        if member is not None:
            self.overlay.node.states.tell(member.target, self.graph.name, state)

    @property
    def state(self) -> str:
        """The state in one word; ``connected`` while a router or another member is linked with us."""
        return overlay_state(self.overlay)

    @property
    def error(self) -> str:
        """The reason why others refuse us, or why there is no link."""
        return self.overlay.node.trouble or self.overlay.node.links.unlinked

    def status(self) -> dict[str, Any]:
        """Return the state of the group, and of the overlay as this member sees it."""
        return {**super().status(), "overlay": self.overlay.node.status()}


def _topics(config: RemoteConfig) -> dict[str, str]:
    """Return the topics that cross, those of paused routes too, each with its name at the members."""
    items = (item for operation, _, item in config.items() if OPERATIONS[operation] == "topic")
    return dict(config.names(item) for item in items)
