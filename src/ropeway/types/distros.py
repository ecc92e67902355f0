"""The same types in other distributions of ROS 2: messages of another layout are recognised and understood.

A few standard messages have changed between distributions (Humble's ``Range`` has no ``variance``). Networks of both
kinds meet in a gateway, and a message that does not fit our layout is then one of theirs.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Final, Generic, Protocol, TypeVar

from ropeway.errors import TypesError
from ropeway.types.bundled import Bundled
from ropeway.types.bundled import has_changed as bundle_has_changed
from ropeway.types.definition import Definition
from ropeway.types.interfaces import owner_of
from ropeway.types.parser import parse_interface, parse_msg
from ropeway.types.stores import DISTROS, store_table

__all__ = ["CHANGED", "ROS2_DISTROS", "OtherDistros", "has_changed"]

ROS2_DISTROS: Final = tuple(distro for distro in DISTROS if distro != "noetic")
"""The distributions that a ROS 2 network can be of."""

CHANGED: Final = frozenset(
    (
        "lifecycle_msgs/msg/TransitionEvent",
        "rcl_interfaces/msg/ParameterDescriptor",
        "rosbag2_interfaces/msg/ReadSplitEvent",
        "rosbag2_interfaces/msg/WriteSplitEvent",
        "sensor_msgs/msg/Range",
        "shape_msgs/msg/SolidPrimitive",
        "visualization_msgs/msg/Marker",
    )
)
"""The messages of the core whose layouts differ between distributions of ROS 2. A test holds them against the stores.

``rmw_dds_common/Gid`` is left out: only discovery uses it, and reads both.
"""

_TRIED: Final = ("humble", "jazzy", "kilted", "iron", "galactic", "foxy", "lyrical")


def has_changed(name: str) -> bool:
    """Return whether an interface, or a part of one, has several layouts in the distributions of ROS 2."""
    return name in CHANGED or bundle_has_changed(name)


class DistroTypes(Protocol):
    """The types of one distribution, as a registry has them."""

    changes: int

    def dependencies(self, name: str) -> Sequence[str]:
        """Return what a type is made of."""
        ...

    def is_standard(self, name: str) -> bool:
        """Return whether a type is as some distribution defines it."""
        ...

    def hash(self, name: str) -> str:
        """Return the hash of a type."""
        ...

    def inward(self, type: str) -> Callable[[bytes], bytes] | None:
        """Return what turns a message of these types into ours; ``None`` where both are the same."""
        ...


R = TypeVar("R", bound=DistroTypes)


class OtherDistros(Generic[R]):
    """The definitions that other distributions have for types that ``registry`` takes from a distribution.

    ``make`` returns the types of a distribution. It raises ``ValueError`` for one that is not known.
    """

    def __init__(self, registry: R, make: Callable[[R, str], R]) -> None:
        self._registry, self._make = registry, make
        self._variants: dict[str, R] = {}
        self._hashes: dict[str, tuple[int, dict[str, R]]] = {}  # by type, and the state of the registry
        self._lock = threading.Lock()

    def have(self, definition: Definition) -> bool:
        """Return whether some distribution defines a message so."""
        name = definition.name
        return has_changed(name) and any(known.same_layout(definition) for known in _layouts(name))

    def touches(self, type: str) -> bool:
        """Return whether the type, or one that it is made of, has another layout in some distribution."""
        registry = self._registry
        try:
            names = (type, *registry.dependencies(type))
        except TypesError:
            return False
        return any(has_changed(name) and registry.is_standard(name) for name in names)

    def adapted(self, type: str, raw: bytes) -> bytes | None:
        """Return the CDR of a message that another distribution has written; ``None`` where none would write it."""
        if not self.touches(type):
            return None
        for distro in _TRIED:
            convert = self.variant(distro).inward(type)
            if convert is None:
                continue
            try:
                return convert(raw)
            except TypesError:
                continue
        return None

    def variant(self, distro: str) -> R:
        """Return the types of another distribution. Raises ``ValueError`` for one that is not known."""
        with self._lock:
            if distro not in self._variants:
                self._variants[distro] = self._make(self._registry, distro)
            return self._variants[distro]

    def by_hash(self, type: str, hash: str) -> R | None:
        """Return whose definition of a type has this hash: ours, a distribution's, or ``None`` for neither."""
        if hash == self._registry.hash(type):
            return self._registry
        state, known = self._hashes.get(type, (-1, {}))
        if state != self._registry.changes:
            known = {self.variant(distro).hash(type): self.variant(distro) for distro in reversed(_TRIED)}
            self._hashes[type] = (self._registry.changes, known)
        return known.get(hash)


def _layouts(name: str) -> Iterator[Definition]:
    """Yield what each distribution of ROS 2 makes of a message, or of a part of a service or action."""
    for distro in ROS2_DISTROS:
        table, bundle, owner = store_table(distro), Bundled(distro), owner_of(name)
        if name in table:
            yield parse_msg(name, table[name])
        elif owner in bundle:
            yield from (part for part in parse_interface(owner, bundle[owner]) if part.name == name)
