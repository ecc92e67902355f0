"""The state of the gateway, and that of its routes."""

from __future__ import annotations

from typing import Any

from ropeway.control.resource import ControlRequest, Resources

__all__ = ["resources"]

resources = Resources()


@resources.get("/v1/status", gives=dict[str, Any])
async def status(asked: ControlRequest) -> Any:
    """Return the state of everything: graphs, listeners, remotes, routes, sessions."""
    return asked.manager.status()
