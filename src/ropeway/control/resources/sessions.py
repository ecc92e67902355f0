"""Shows the clients of the gateway, and disconnects one."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from ropeway.control.resource import Audited, ControlRequest, Resources
from ropeway.errors import ControlRefused

if TYPE_CHECKING:
    from ropeway.gateway.gateway import Gateway

__all__ = ["disconnect", "resources"]

log = logging.getLogger("ropeway.control")

resources = Resources()

_POLICY_VIOLATION: Final = 1008  # of RFC 6455


@resources.get("/v1/sessions", gives=list[dict[str, Any]])
async def sessions(asked: ControlRequest) -> Any:
    """Return the clients and gateways that are connected."""
    return asked.manager.status()["sessions"]


@resources.delete("/v1/sessions/{peer}", right="operate", audited=Audited("disconnect", "peer", "kicked"))
async def kick(asked: ControlRequest) -> Any:
    """Disconnect the client at ``peer``, its address and port; it may come back."""
    peer = asked.path["peer"]
    if not any(await asked.manager.ask(disconnect, {"peer": peer})):
        raise ControlRefused(404, f"no client is connected from {peer}")
    log.warning("%s was disconnected, as %s asked", peer, asked.caller)
    asked.manager.events.tell("client", peer, state="kicked", before="connected", why=f"asked by {asked.caller}")
    return {"kicked": peer}


async def disconnect(gateway: Gateway, params: Mapping[str, Any]) -> Any:
    """Close the connection of a client; return whether it was there."""
    found = [session for session in gateway.sessions if session.connection.peer == params["peer"]]
    for session in found:
        session.connection.close(_POLICY_VIOLATION, "disconnected by an operator")
    return bool(found)
