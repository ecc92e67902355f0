"""The same types in other distributions of ROS 2: messages of another layout are carried over by the names of fields.

A few standard messages have changed between distributions (Humble's ``Range`` has no ``variance``). Networks of both
kinds meet in a gateway, and a message that does not fit our layout is then one of theirs.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Final, TypeAlias

from ropeway.errors import TypesError
from ropeway.types.definition import Definition, short_name
from ropeway.types.ros1_convert import names_between, renamed
from ropeway.types.stores import DISTROS

if TYPE_CHECKING:
    from ropeway.types.registry import TypeRegistry

__all__ = ["CHANGED", "ROS2_DISTROS", "OtherDistros"]

Convert: TypeAlias = Callable[[bytes], bytes]

log = logging.getLogger("ropeway.types")

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
"""The messages whose layouts differ between distributions of ROS 2. A test holds them against the stores.

``rmw_dds_common/Gid`` is left out: only discovery uses it, and reads both.
"""

_TRIED: Final = ("humble", "kilted", "iron", "galactic", "foxy", "lyrical")  # Jazzy has Kilted's layouts


class OtherDistros:
    """What other distributions make of the types of ``registry``, as far as they are built in there."""

    def __init__(self, registry: TypeRegistry, make: Callable[[str], TypeRegistry]) -> None:
        self._registry, self._make = registry, make
        self._made: dict[str, TypeRegistry] = {}
        self._said: set[tuple[str, str]] = set()
        self._converters: dict[tuple[str, str, bool], tuple[object, Convert | None]] = {}
        self._lock = threading.Lock()

    def touches(self, type: str) -> bool:
        """True if the type, or one that it is made of, has another layout in some distribution."""
        try:
            names = (type, *self._registry.dependencies(type))
        except TypesError:
            return False
        return any(name in CHANGED and self._registry.is_builtin(name) for name in names)

    def adapted(self, type: str, raw: bytes) -> bytes | None:
        """The CDR of a message that another distribution has written; ``None`` where none would write it."""
        if not self.touches(type):
            return None
        for distro in _TRIED:
            convert = self._converter(type, distro, back=False)
            if convert is None:
                continue
            try:
                return convert(raw)
            except TypesError:
                continue
        return None

    def toward(self, type: str, distro: str) -> Convert | None:
        """What turns our CDR into that of ``distro``; ``None`` where both are the same."""
        return self._converter(type, distro, back=True) if self.touches(type) else None

    def registry(self, distro: str) -> TypeRegistry:
        """The definitions of another distribution. Raises ``ValueError`` for one that is not known."""
        with self._lock:
            if distro not in self._made:
                self._made[distro] = self._make(distro)
            return self._made[distro]

    def _converter(self, type: str, distro: str, *, back: bool) -> Convert | None:
        """What turns their CDR into ours, or ``back``; kept until our definition changes."""
        codec = self._registry.codec(type)
        known = self._converters.get((type, distro, back))
        if known is None or known[0] is not codec:
            known = self._converters[type, distro, back] = (codec, self._make_converter(type, distro, back=back))
        return known[1]

    def _make_converter(self, type: str, distro: str, *, back: bool) -> Convert | None:
        other, ours = self.registry(distro), self._registry
        differences = list(_differences(type, other, ours))
        if not differences:
            return None
        here, there = (ours, other) if back else (other, ours)
        names = names_between(type, here.definition, type, there.definition)
        read, write = here.codec(type).decode, there.codec(type).encode

        def convert(raw: bytes) -> bytes:
            made = write(renamed(read(raw), names))
            self._report(type, distro, differences)
            return made

        return convert

    def _report(self, type: str, distro: str, differences: list[str]) -> None:
        if (type, distro) not in self._said:
            self._said.add((type, distro))
            for difference in differences:
                log.warning("%s", difference.format(distro=distro.title()))


def _differences(type: str, other: TypeRegistry, ours: TypeRegistry) -> Iterator[str]:
    """How the layouts of a type differ, in sentences; nothing where they do not or ``other`` does not have it."""
    try:
        names = {type, *other.dependencies(type)} & {type, *ours.dependencies(type)}
        for name in sorted(names & CHANGED):
            theirs, mine = other.definition(name), ours.definition(name)
            if not theirs.same_layout(mine):
                yield from _fields(theirs, mine)
    except TypesError:
        return


def _fields(theirs: Definition, mine: Definition) -> Iterator[str]:
    short = short_name(mine.name)
    there, here = {f.name for f in theirs.wire_fields}, {f.name for f in mine.wire_fields}
    for field in mine.wire_fields:
        if field.name not in there:
            value = 0 if field.default is None else field.default
            yield f"{short}.{field.name} is missing in {{distro}}, filled with {value}"
    for field in theirs.wire_fields:
        if field.name not in here:
            yield f"{short}.{field.name} of {{distro}} is not known here and left out"
    if there == here:
        yield f"{short} has another layout in {{distro}}; its fields are carried over by name"
