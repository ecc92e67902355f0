"""Types of a configuration that nobody here knows: seldom wrong, often mistyped."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from ropeway.errors import TypesError, UnknownType

if TYPE_CHECKING:
    from ropeway.gateway.config.config import Config
    from ropeway.types import TypeRegistry

__all__ = ["known_types", "learn_types", "type_hints"]

_KINDS: Final = {"service": "srv", "action": "action"}


def known_types(config: Config) -> TypeRegistry:
    """Return the types that a gateway with this configuration knows before it meets anybody."""
    from ropeway.types import TypeRegistry

    registry = TypeRegistry()
    learn_types(config, registry)
    return registry


def learn_types(config: Config, registry: TypeRegistry) -> None:
    """Add what the configuration names, and the sourced workspaces: first for everybody, then for one network alone."""
    from ropeway.types.variant import make_network

    for path in config.gateway.types:
        registry.add_path(path)
    registry.add_ament_prefix_path()
    networks = [(network.address, network.types) for network in config.gateway.networks]
    networks += [(remote.address, remote.types) for remote in config.remotes]
    for address, types in networks:
        make_network(registry, None, types, label=address)


def type_hints(config: Config, registry: TypeRegistry) -> list[tuple[str, str]]:
    """Return where unknown types are named and what may be meant, each type once.

    Such a type may be right: between gateways messages cross as they are, and peers can tell definitions.
    """
    hints: dict[str, tuple[str, str]] = {}
    for path, type, kind in _named(config):
        if type not in hints and not registry.has(type, kind):
            hints[type] = (f"{path}.type", _hint(type, kind, registry))
    return list(hints.values())


def _named(config: Config) -> Iterator[tuple[str, str, str]]:
    """Yield every place of the configuration that names a type, with the type and its kind."""
    for route in config.routes():
        yield route.path, route.type, _KINDS.get(route.operation.rpartition("-")[2], "msg")
    maps = [("gateway.iort", config.gateway.iort.maps)]
    maps += [(f"remotes[{index}]", remote.maps) for index, remote in enumerate(config.remotes) if remote.active]
    for path, items in maps:
        for number, item in enumerate(items):
            yield f"{path}.maps[{number}]", item.type, "msg"


def _hint(type: str, kind: str, registry: TypeRegistry) -> str:
    try:
        registry.codec(type)
    except UnknownType as error:
        if error.nearest and error.nearest.split("/")[1] == kind:
            return f'the type {type} is not known; did you mean "{error.nearest}"?'
    except TypesError as error:
        return str(error)
    return f'the type {type} is not known here; name its definition under "gateway.types" where it must be read'
