"""The message definitions that ``rosbags`` ships, one table per ROS distribution.

Importing a store of rosbags builds a dataclass for each of its types, 0.2 s that a gateway has better use for at its
start: Ropeway only needs the field tables. So the module's code runs here with a decorator that builds nothing;
the tables are the same objects a plain import gives.
"""

from __future__ import annotations

import builtins
import threading
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final, cast

from ropeway.errors import InvalidDefinition
from ropeway.types.definition import PRIMITIVES, Constant, Definition, Field, FieldType
from ropeway.types.standard import DEFAULTS

__all__ = ["DISTROS", "NEWEST", "from_rosbags", "store_table"]

NEWEST: Final = "kilted"
"""What a registry has by default: all of Jazzy in the same layouts, and more. Lyrical has dropped some."""

DISTROS: Final = {
    "noetic": "ros1_noetic",
    "foxy": "ros2_foxy",
    "galactic": "ros2_galactic",
    "humble": "ros2_humble",
    "iron": "ros2_iron",
    "jazzy": "ros2_jazzy",
    "kilted": "ros2_kilted",
    "lyrical": "ros2_lyrical",
}
"""The distributions a registry can be named after, and the modules of rosbags that hold them."""

_NAME, _ARRAY, _SEQUENCE = 2, 3, 4  # Nodetype of rosbags.interfaces; 1 is a primitive

_lock: Final = threading.Lock()
_modules: dict[str, Any] = {}


def store_table(distro: str) -> Mapping[str, Any]:
    """The field table of ``distro``: full name to constants and fields as rosbags writes them.

    Raises ``ValueError`` for a distribution that is not known.
    """
    if distro not in DISTROS:
        raise ValueError(f"{distro!r} is not a known ROS distribution; known are {', '.join(DISTROS)}")
    with _lock:
        table: Mapping[str, Any] = _module(DISTROS[distro]).FIELDDEFS
    return table


def _module(name: str) -> Any:
    """The store module ``name`` of rosbags, or a namespace with the same ``FIELDDEFS``."""
    if name in _modules:
        return _modules[name]
    import rosbags.interfaces  # a cheap part of the package; rosbags.typesys would bring all its parsers

    full = f"rosbags.typesys.stores.{name}"
    path = Path(rosbags.interfaces.__file__).parents[1] / "typesys" / "stores" / f"{name}.py"
    if path.exists():
        scope: dict[str, Any] = {"__name__": full, "__builtins__": {**vars(builtins), "__import__": _import}}
        exec(cast(Any, SourceFileLoader(full, str(path)).get_code(full)), scope)  # noqa: S102 - rosbags' own module
        _modules[name] = SimpleNamespace(**scope)
    else:
        _modules[name] = import_module(full)
    return _modules[name]


def _import(
    name: str,
    scope: Mapping[str, Any] | None = None,
    local: Mapping[str, Any] | None = None,
    fromlist: Sequence[str] | None = (),
    level: int = 0,
) -> Any:
    """``import`` as a store module sees it: an older store comes the same way, ``dataclass`` does nothing."""
    if level == 1 and not name:
        return SimpleNamespace(**{store: _module(store) for store in fromlist or ()})
    if name == "dataclasses":
        return SimpleNamespace(dataclass=lambda made: made)
    return builtins.__import__(name, scope, local, fromlist or (), level)


def from_rosbags(name: str, entry: Any) -> Definition:
    """The definition of ``name`` from one entry of a table of rosbags."""
    constants, fields = entry
    defaults = DEFAULTS.get(name, {})
    return Definition(
        name,
        tuple(
            Field(field, _type(name, described), defaults.get(field))
            for field, described in fields
            if field != "structure_needs_at_least_one_member"
        ),
        tuple(Constant(constant, type, value, str(value)) for constant, type, value in constants),
    )


def _type(name: str, described: Any) -> FieldType:
    node, rest = int(described[0]), described[1]
    if node == _NAME:
        return FieldType(rest)
    if node in (_ARRAY, _SEQUENCE):
        inner = _type(name, rest[0])
        return FieldType(inner.base, inner.bound, "array" if node == _ARRAY else "sequence", rest[1])
    base, bound = rest
    if base not in PRIMITIVES:
        raise InvalidDefinition(name, f"fields of type {base} are not supported")
    return FieldType(base, bound)
