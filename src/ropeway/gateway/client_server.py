"""Makes the server of rosbridge clients and gateways as a configuration has it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from ropeway.networks.rosbridge.server import RosbridgeServer

if TYPE_CHECKING:
    from ropeway.gateway.config.model import GatewayConfig
    from ropeway.hub.hub import Hub
    from ropeway.listener.client_pages import ClientPages
    from ropeway.listener.connection import Limits
    from ropeway.listener.entrance import Entrance
    from ropeway.networks.foxglove.server import FoxgloveServer
    from ropeway.types import TypeRegistry

__all__ = ["make_client_server"]


def make_client_server(
    settings: GatewayConfig,
    hub: Hub,
    registry: TypeRegistry,
    *,
    gateway_id: str,
    node: str,
    limits: Limits,
    entrance: Entrance,
    reasons: Callable[[], list[str]],
    pages: Sequence[ClientPages],
    guests: FoxgloveServer | None,
) -> RosbridgeServer:
    """Make the server, which listens nowhere yet. ``reasons`` say why the gateway is not ready."""
    clients = settings.clients
    return RosbridgeServer(
        hub,
        registry,
        gateway_id=gateway_id,
        name=settings.name,
        node=node,
        limits=limits,
        entrance=entrance,
        reasons=reasons,
        unregister_timeout_s=clients.unregister_timeout_s,
        call_timeout_s=clients.call_timeout_s,
        params_timeout_s=clients.params_timeout_s,
        silence_s=clients.silence_s,
        ping_interval_s=clients.ping_interval_s,
        cancel_goals=clients.cancel_goals,
        publish_clients=clients.publish_clients,
        publish_rosout=clients.publish_rosout,
        pages=pages,
        guests=guests,
    )
