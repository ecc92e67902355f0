"""Tries a route of a configuration: a gateway comes up for a moment, with nothing but this route."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any, Final

from ropeway.cli.patience import patiently
from ropeway.gateway.config.config import Config
from ropeway.gateway.config.fleet import load_one
from ropeway.gateway.config.route_model import TopicItem
from ropeway.gateway.explain import Explanation
from ropeway.gateway.explain.routes import without_route
from ropeway.gateway.gateway import Gateway
from ropeway.gateway.remote import shown_address

__all__ = ["only_routes_of", "try_out"]

_LOOK_S: Final = 0.25


async def try_out(file: Path, name: str, to: str, spin_time_s: float, part: str = "") -> list[Explanation]:
    """Return what is found once the route crosses, or after ``spin_time_s``."""
    config = load_one(file, part)
    narrow = only_routes_of(config, name)
    if not narrow.routes():
        remotes = [remote for remote in config.remotes if remote.active]
        names = [known for route in config.routes() for known in (route.name, route.remote_name)]
        return [without_route(name, to, [f"{shown_address(r)} {r.title}".rstrip() for r in remotes], names)]
    loop = asyncio.get_running_loop()
    async with patiently(lambda: f"trying the route of {name}"), Gateway(narrow) as gateway:
        deadline = loop.time() + spin_time_s
        while True:
            found = await gateway.explain(name, to) if _reached(gateway) else []
            if found and all(explanation.crosses for explanation in found):
                return found
            if loop.time() >= deadline:
                return found or await gateway.explain(name, to)
            await asyncio.sleep(_LOOK_S)


def only_routes_of(config: Config, name: str) -> Config:
    """Return a configuration with the routes of one name only, which listens nowhere and keeps nothing."""
    kept = {route.path for route in config.routes() if name in (route.name, route.remote_name)}
    remotes = []
    for index, remote in enumerate(config.remotes):
        update: dict[str, Any] = {}
        for operation, number, item in remote.items():
            field = operation.replace("-", "_")
            chosen = update.setdefault(field, ())
            if f"remotes[{index}].{operation}[{number}]" in kept:
                update[field] = (
                    *chosen,
                    item.model_copy(update={"store": False}) if isinstance(item, TopicItem) else item,
                )
        remotes.append(remote.model_copy(update={**update, "automatic": None}))
    gateway = config.gateway.model_copy(update={"listen": (), "workers": 0, "store": None})
    return Config(gateway, tuple(remotes), config.source)


def _reached(gateway: Gateway) -> bool:
    return all(remote.state == "connected" for remote in gateway.remotes)
