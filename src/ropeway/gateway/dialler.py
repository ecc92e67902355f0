"""Makes the graphs behind ``ws://`` and ``wss://`` remotes."""

from __future__ import annotations

from dataclasses import dataclass

from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.credentials import Credentials
from ropeway.listener.connection import Limits
from ropeway.listener.http import without_token
from ropeway.networks.rosbridge.client.by_interface import InterfaceGraph
from ropeway.types import TypeRegistry
from ropeway.types.variant import make_network

__all__ = ["Dialler"]


@dataclass(frozen=True, slots=True)
class Dialler:
    """Holds what all links of a gateway have in common; ``name`` is that of the gateway."""

    registry: TypeRegistry
    gateway_id: str
    name: str
    limits: Limits

    def graph(
        self,
        config: RemoteConfig,
        url: str,
        shown: Credentials,
        *,
        watch: bool,
        looks_on: bool = False,
        interface: str = "",
    ) -> InterfaceGraph:
        """Return the graph behind one address of a remote, not opened; ``looks_on`` for somebody who only looks."""
        return InterfaceGraph(
            url,
            interface or next(iter(config.interfaces), ""),
            registry=self.registry,
            limits=self.limits,
            ssl_context=shown.context,
            headers=shown.headers,
            gateway_id=self.gateway_id,
            name=self.name,
            wait=looks_on,
            watch=watch,
            ask_rosapi=looks_on,
            ros1=None if config.ros is None else config.ros == 1,
            network=make_network(self.registry, config.distro, config.types, label=without_token(url)),
        )
