"""Questions by which a supervisor has its workers change together: all prepare, then all swap, or none does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ropeway.errors import ControlRefused
from ropeway.gateway.config.config import parse

if TYPE_CHECKING:
    from ropeway.gateway.gateway import Gateway

__all__ = ["abort", "commit", "prepare"]


async def prepare(gateway: Gateway, params: Mapping[str, Any]) -> None:
    """Start what is new of a configuration beside what runs."""
    await abort(gateway, params)
    await gateway.prepare(parse(params["config"], params["source"]))


async def commit(gateway: Gateway, params: Mapping[str, Any]) -> None:
    """Swap."""
    change, gateway.change = gateway.change, None
    if change is None:
        raise ControlRefused(409, "nothing was prepared here")
    await change.commit()


async def abort(gateway: Gateway, params: Mapping[str, Any]) -> None:
    """Take back what was prepared, if anything was."""
    change, gateway.change = gateway.change, None
    if change is not None:
        await change.abort()
