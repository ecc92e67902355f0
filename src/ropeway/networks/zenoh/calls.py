"""Defines what clients and services of a ``zenoh`` graph share: what they need of it, and the profile they show."""

from __future__ import annotations

from typing import Final, Protocol

from ropeway.graph.host import Host
from ropeway.networks.zenoh.discovery import ZenohDiscovery
from ropeway.networks.zenoh.hashed_layouts import HashedLayouts
from ropeway.networks.zenoh.sender import Sender
from ropeway.networks.zenoh.session import ZenohSession
from ropeway.qos import PROFILES, QoS
from ropeway.types import TypeRegistry

__all__ = ["REQUEST", "RESPONSE", "SERVICE_QOS", "ZenohCallHost"]

SERVICE_QOS: Final[QoS] = PROFILES["services_default"]
REQUEST: Final = "_Request"
RESPONSE: Final = "_Response"


class ZenohCallHost(Host, Protocol):
    """The services of a graph for clients and services."""

    session: ZenohSession
    sender: Sender
    layouts: HashedLayouts
    discovery: ZenohDiscovery

    @property
    def registry(self) -> TypeRegistry:
        """The definitions of types."""
        ...

    def forget(self, part: object) -> None:
        """Forget a client or service that was closed."""
        ...
