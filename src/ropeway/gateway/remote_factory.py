"""Makes the remotes of a gateway: a link, a group, a server of nodes, a broker, or the overlay."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ropeway.extras import require
from ropeway.gateway.bridges import fetch
from ropeway.gateway.config.address import is_iort, is_mqtt
from ropeway.gateway.config.config import Route
from ropeway.gateway.config.model import GatewayConfig, RemoteConfig
from ropeway.gateway.config.overlay_model import OVERLAY
from ropeway.gateway.credentials import read_credentials
from ropeway.gateway.dialler import Dialler
from ropeway.gateway.remote import IortRemote, LinkRemote, MqttRemote, OverlayRemote, Remote
from ropeway.listener.connection import Limits
from ropeway.networks.rosbridge.client.by_interface import InterfaceGraph
from ropeway.types import TypeRegistry

if TYPE_CHECKING:
    from ropeway.gateway.group import GroupRemote
    from ropeway.networks.overlay.graph import OverlayGraph
    from ropeway.networks.overlay.node import OverlayNode

__all__ = ["RemoteFactory"]


class RemoteFactory:
    """Makes remotes that are not open yet; those of the overlay share one node."""

    def __init__(
        self, settings: GatewayConfig, registry: TypeRegistry, *, gateway_id: str, node_name: str, limits: Limits
    ) -> None:
        self.node: OverlayNode | None = None
        self._settings, self._registry, self._node_name = settings, registry, node_name
        self._dialler = Dialler(registry, gateway_id, settings.name, limits)

    def make(self, config: RemoteConfig, index: int, routes: Sequence[Route]) -> Remote:
        """Make the remote of a configuration. Raises ``ConfigError`` where its credentials cannot be read."""
        if config.address == OVERLAY and config.anycast is not None:
            return self._overlay_group(config)
        if config.address == OVERLAY:
            return OverlayRemote(config, self._overlay_graph(config))
        if is_iort(config.address):
            return self._iort_remote(config, index)
        if is_mqtt(config.address):
            return self._mqtt_remote(config, index)
        if len(config.addresses) > 1:
            return self._group(config, index, routes)
        if len(config.interfaces) > 1:
            return self._links(config, index, routes)
        return self._link(config, index, routes)

    def _iort_remote(self, config: RemoteConfig, index: int) -> IortRemote:
        from ropeway.networks.iort.graph import IortGraph
        from ropeway.networks.iort.links import RemoteLink
        from ropeway.networks.iort.maps import Maps

        shown = read_credentials(config, index)
        name = self._settings.name
        link = RemoteLink(config.address, name, token=shown.token, ssl_context=shown.context, wait_s=0.0)
        maps = Maps([item.as_map() for item in config.maps])
        return IortRemote(config, IortGraph(link, name=config.address, maps=maps, registry=self._registry), link, shown)

    def _mqtt_remote(self, config: RemoteConfig, index: int) -> MqttRemote:
        require("mqtt", "an MQTT broker")
        from ropeway.networks.mqtt.address import parse_address
        from ropeway.networks.mqtt.graph import MqttGraph  # loads paho
        from ropeway.networks.mqtt.maps import MqttMaps

        shown, address = read_credentials(config, index), parse_address(config.address)
        graph = MqttGraph(
            address,
            node=self._settings.name,
            user=config.user or "",
            password=shown.password,
            ssl_context=shown.context,
            maps=MqttMaps(item.as_map() for item in config.topics),
            discover=address.discover or (),
            registry=self._registry,
            wait_s=0.0,
            max_message_bytes=self._settings.max_message_bytes,
        )
        return MqttRemote(config, graph, shown)

    def _link(self, config: RemoteConfig, index: int, routes: Sequence[Route]) -> LinkRemote:
        shown = read_credentials(config, index)
        graph = self._dialler.graph(config, config.address, shown, watch=fetch(routes))
        return LinkRemote(config, graph, shown, make_onlooker=lambda: self._onlooker(config, index))

    def _onlooker(self, config: RemoteConfig, index: int) -> InterfaceGraph:
        shown = read_credentials(config, index)
        return self._dialler.graph(config, config.address, shown, watch=True, looks_on=True)

    def _group(self, config: RemoteConfig, index: int, routes: Sequence[Route]) -> GroupRemote:
        from ropeway.gateway.group import LinkGroupRemote  # most gateways have no group

        shown = read_credentials(config, index)
        graphs = (self._dialler.graph(config, url, shown, watch=fetch(routes)) for url in config.addresses)
        links = {graph.name: graph for graph in graphs}
        return LinkGroupRemote(config, links, self._registry, shown, self._settings.name)

    def _links(self, config: RemoteConfig, index: int, routes: Sequence[Route]) -> Remote:
        from ropeway.gateway.links import LinksRemote  # most gateways have one link

        shown = read_credentials(config, index)
        watch = fetch(routes)
        links = {
            name: self._dialler.graph(config, config.address, shown, watch=watch, interface=name)
            for name in config.interfaces
        }
        return LinksRemote(config, links, self._registry, shown)

    def _overlay_group(self, config: RemoteConfig) -> GroupRemote:
        from ropeway.gateway.group import OverlayGroupRemote

        return OverlayGroupRemote(config, self._overlay_graph(config), self._registry, self._settings.name)

    def _overlay_graph(self, config: RemoteConfig) -> OverlayGraph:
        require("overlay", "the overlay")
        from ropeway.networks.overlay.crypto.identity import Identity
        from ropeway.networks.overlay.graph import OverlayGraph  # loads Zenoh, which others do not need
        from ropeway.networks.overlay.names import Metadata
        from ropeway.networks.overlay.node import OverlayNode

        settings = self._settings.overlay
        assert settings is not None
        if self.node is None or self.node.closed:
            self.node = OverlayNode(
                Identity.load(settings.identity),
                routers=settings.routers,
                listen=settings.listen,
                interfaces=settings.interfaces,
                links=settings.links,
                max_message_bytes=self._settings.max_message_bytes,
                sessions=settings.authenticity == "session",
            )
        about = Metadata(settings.author, settings.maintainer, settings.description, config.unique or "", settings.node)
        everybody = ("*",)
        return OverlayGraph(
            self.node,
            metadata=about,
            readers=everybody if config.readers is None else config.readers,
            callers=everybody if config.callers is None else config.callers,
            registry=self._registry,
            node_name=self._node_name,
        )
