"""Types of a configuration that nobody here knows: seldom wrong, often mistyped."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ropeway.errors import TypesError, UnknownType

if TYPE_CHECKING:
    from ropeway.gateway.config import Config
    from ropeway.types import TypeRegistry

__all__ = ["known_types", "type_hints"]

_KINDS: Final = {"service": "srv", "action": "action"}


def known_types(config: Config) -> TypeRegistry:
    """The types that a gateway with this configuration knows before it meets anybody."""
    from ropeway.types import TypeRegistry

    registry = TypeRegistry()
    for path in config.gateway.types:
        registry.add_path(path)
    registry.add_ament_prefix_path()
    return registry


def type_hints(config: Config, registry: TypeRegistry) -> list[tuple[str, str]]:
    """Where a type stands that is not known, and what may be meant, each type once.

    Such a type may be right: between gateways messages cross as they are, and peers can tell definitions.
    """
    hints: dict[str, tuple[str, str]] = {}
    for route in config.routes():
        kind = _KINDS.get(route.operation.rpartition("-")[2], "msg")
        if route.type in hints or registry.has(route.type, kind):
            continue
        hints[route.type] = (f"{route.path}.type", _hint(route.type, kind, registry))
    return list(hints.values())


def _hint(type: str, kind: str, registry: TypeRegistry) -> str:
    try:
        registry.codec(type)
    except UnknownType as error:
        if error.nearest and error.nearest.split("/")[1] == kind:
            return f'the type {type} is not known; did you mean "{error.nearest}"?'
    except TypesError as error:
        return str(error)
    return f'the type {type} is not known here; name its definition under "gateway.types" where it must be read'
