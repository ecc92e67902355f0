"""A configuration, and the gateway that runs it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ropeway.gateway.gateway import Gateway

__all__ = ["Gateway"]


def __getattr__(name: str) -> Any:
    if name == "Gateway":  # reading a configuration must not load every kind of network
        from ropeway.gateway.gateway import Gateway

        return Gateway
    raise AttributeError(name)
