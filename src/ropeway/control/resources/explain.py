"""Answers why something crosses or does not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ropeway.control.resource import ControlRequest, Resources
from ropeway.errors import ControlRefused, InvalidName
from ropeway.graph.base import resolve_name

if TYPE_CHECKING:
    from ropeway.gateway.gateway import Gateway

__all__ = ["explain_name", "resources"]

resources = Resources()


@resources.get("/v1/explain", gives=list[dict[str, Any]])
async def explain(asked: ControlRequest) -> Any:
    """Explain why ``?name=`` crosses to ``&to=`` or does not, step by step on both ends: an entry per route."""
    try:
        name = resolve_name(asked.query.get("name", ""))
    except InvalidName as error:
        raise ControlRefused(422, f"name: {error.reason}") from None
    answers = await asked.manager.ask(explain_name, {"name": name, "to": asked.query.get("to", "")})
    found = [explanation for answer in answers for explanation in answer]
    return [explanation for explanation in found if explanation["path"]] or found[:1]


async def explain_name(gateway: Gateway, params: Mapping[str, Any]) -> Any:
    """Return what one gateway, or one worker of it, has to say."""
    return [explanation.to_json() for explanation in await gateway.explain(params["name"], params["to"])]
