"""Asks a gateway for its recorders, wherever it runs: see ``questions``."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ropeway.gateway.gateway import Gateway

__all__ = ["list_recordings", "start_recording", "stop_recording", "trigger_recording"]


async def list_recordings(gateway: Gateway, params: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return how the recorders are, and their files."""
    return await asyncio.to_thread(gateway.recorders.listed)


async def start_recording(gateway: Gateway, params: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Start a recorder, or all."""
    await gateway.recorders.start(params["name"])
    return gateway.recorders.status()


async def stop_recording(gateway: Gateway, params: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Stop a recorder, or all."""
    await gateway.recorders.stop(params["name"])
    return gateway.recorders.status()


async def trigger_recording(gateway: Gateway, params: Mapping[str, Any]) -> list[str]:
    """Trigger a clip; return the recorders that write one."""
    return gateway.recorders.trigger(params["name"], params["why"])
