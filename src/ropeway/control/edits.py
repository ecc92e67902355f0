"""Edits of a configuration in the full form: one route more, one less, one that pauses."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, Final

from ropeway.errors import ConfigError, ControlRefused
from ropeway.gateway.config.config import Config, Route
from ropeway.gateway.config.route_model import OPERATIONS
from ropeway.gateway.config.suggest import one_of

__all__ = ["Edit", "add_route", "remove_route", "set_active"]

Edit = Callable[[Config, dict[str, Any]], None]
"""Changes a document in place, which is the full form of the configuration."""

_PATH: Final = re.compile(r"remotes\[(\d+)\]\.([a-z-]+)\[(\d+)\]")


def add_route(remote: str, operation: str, item: Mapping[str, Any]) -> Edit:
    """Add a route to the remote of an address, a title or a number; one of a new address is made."""
    if operation not in OPERATIONS:
        raise ConfigError([("operation", one_of(operation, OPERATIONS))])

    def edit(_: Config, document: dict[str, Any]) -> None:
        remotes = document["remotes"]
        found = _remote(remotes, remote)
        if found is None:
            found = {"address": remote}
            remotes.append(found)
        found[operation] = [*found.get(operation, ()), dict(item)]

    return edit


def remove_route(key: str) -> Edit:
    """Remove the route of a key."""

    def edit(config: Config, document: dict[str, Any]) -> None:
        index, operation, number = _place(config, key)
        items = list(document["remotes"][index][operation])
        del items[number]
        document["remotes"][index][operation] = items

    return edit


def set_active(key: str, *, active: bool) -> Edit:
    """Pause the route of a key, or let it go on."""

    def edit(config: Config, document: dict[str, Any]) -> None:
        index, operation, number = _place(config, key)
        items = [dict(item) for item in document["remotes"][index][operation]]
        items[number]["active"] = active
        document["remotes"][index][operation] = items

    return edit


def _remote(remotes: list[dict[str, Any]], name: str) -> dict[str, Any] | None:
    if name.isascii() and name.isdigit():
        if int(name) >= len(remotes):
            raise ControlRefused(404, f"there are {len(remotes)} remotes; the first has the number 0")
        return remotes[int(name)]
    named = [one for one in remotes if name in (one.get("title"), *_addresses(one))]
    if len(named) > 1:
        raise ControlRefused(409, f"{len(named)} remotes are called {name}; give the number of one, from 0 on")
    return named[0] if named else None


def _addresses(remote: Mapping[str, Any]) -> list[str]:
    address = remote.get("address")
    return [address] if isinstance(address, str) else list(address or ())


def _place(config: Config, key: str) -> tuple[int, str, int]:
    found: list[Route] = [route for active in (True, False) for route in config.routes(active=active)]
    for route in found:
        match = _PATH.fullmatch(route.path) if route.key == key else None
        if match is not None:
            return int(match[1]), match[2], int(match[3])
    raise ControlRefused(404, f"there is no route with the key {key[:64]}; GET /v1/routes lists them")
