"""Asks for topics of a gateway, wherever it runs: see ``questions``. A fault is an answer with ``error``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ropeway.errors import RopewayError
from ropeway.tasks import describe

if TYPE_CHECKING:
    from ropeway.gateway.gateway import Gateway

__all__ = ["list_topics", "look_at_topic", "publish_message"]


async def list_topics(gateway: Gateway, params: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return all topics of the gateway's graphs."""
    return gateway.looks.listed()


async def look_at_topic(gateway: Gateway, params: Mapping[str, Any]) -> dict[str, Any]:
    """Return the newest message of a topic."""
    try:
        return await gateway.looks.look(params["name"], params["graph"], after=params["after"])
    except RopewayError as error:
        return {"error": describe(error)}


async def publish_message(gateway: Gateway, params: Mapping[str, Any]) -> dict[str, Any]:
    """Publish a message."""
    try:
        return await gateway.looks.publish(
            params["name"], params["type"], params["message"], driver=params["driver"], graph=params["graph"]
        )
    except RopewayError as error:
        return {"error": describe(error)}
