"""Makes the server of viewers of a gateway, as its configuration says."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ropeway.limits import LONGEST_CALL_S
from ropeway.networks.foxglove.server import FoxgloveServer

if TYPE_CHECKING:
    from ropeway.gateway.config.model import GatewayConfig
    from ropeway.hub.hub import Hub
    from ropeway.listener.connection import Limits
    from ropeway.listener.entrance import Entrance
    from ropeway.types import TypeRegistry

__all__ = ["serve_viewers"]


def serve_viewers(
    settings: GatewayConfig, hub: Hub, registry: TypeRegistry, limits: Limits, entrance: Entrance
) -> FoxgloveServer:
    """Return the server, which listens nowhere yet."""
    return FoxgloveServer(
        hub,
        registry,
        settings.foxglove.settings(),
        name=settings.name,
        limits=limits,
        entrance=entrance,
        call_timeout_s=settings.clients.call_timeout_s or LONGEST_CALL_S,
        params_timeout_s=settings.clients.params_timeout_s,
        silence_s=settings.clients.silence_s,
        ping_interval_s=settings.clients.ping_interval_s,
    )
