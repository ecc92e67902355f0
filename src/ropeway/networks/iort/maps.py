"""Maps topics of systems to ROS topics: names, types, and the form in which they are written."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, Final

from ropeway.types import TypeRegistry
from ropeway.types.forms import Form, default_form, make_form

__all__ = ["NO_SYSTEM", "Maps", "TopicMap", "names_of", "ros_name"]

NO_SYSTEM: Final = "ROS"
"""The system of ROS topics whose names have one part only, as ``/chatter``."""

_STRING: Final = "std_msgs/msg/String"
_ODD: Final = re.compile(r"[^A-Za-z0-9_/]")


@dataclass(frozen=True)
class TopicMap:
    """Maps a topic of IoRT nodes to a ROS topic.

    ``system`` and ``topic`` may be patterns. ``name`` is the ROS name, ``""`` for ``/SYSTEM/TOPIC``. ``direction`` is
    ``both``, ``in`` (nodes publish, ROS reads) or ``out``. ``latched``: ROS's late joiners get the last value, too.
    """

    system: str
    topic: str
    type: str = _STRING
    form: str = ""
    name: str = ""
    direction: str = "both"
    latched: bool = False
    options: Mapping[str, Any] = field(default_factory=dict)

    def fits(self, system: str, topic: str) -> bool:
        """Return whether the patterns match the topic."""
        return fnmatchcase(system, self.system) and fnmatchcase(topic, self.topic)

    @property
    def is_pattern(self) -> bool:
        """Whether it stands for several topics."""
        return any(c in self.system + self.topic for c in "*?[")

    def ros_name(self, system: str, topic: str) -> str:
        """Return the ROS name of a topic that it fits."""
        return self.name or ros_name(system, topic)

    def make_form(self, registry: TypeRegistry, clock: Callable[[], float] = time.monotonic) -> Form:
        """Make a form of its own: some forms have memory. Raises ``TypesError``."""
        if not self.form:
            return default_form(self.type, registry)
        return make_form(self.form, self.type, registry, self.options, clock=clock)


class Maps:
    """An ordered list of maps; the first that fits counts."""

    def __init__(self, maps: Iterable[TopicMap] = ()) -> None:
        self.maps = tuple(maps)

    def of(self, system: str, topic: str) -> TopicMap | None:
        """Return the map of a topic of nodes, ``None`` for an unmapped one."""
        return next((m for m in self.maps if m.fits(system, topic)), None)

    def at(self, name: str, direction: str) -> list[tuple[str, str, TopicMap | None]]:
        """Return the topics of nodes behind a ROS name, ``in`` or ``out``: ``(system, topic, map)``."""
        found: list[tuple[str, str, TopicMap | None]] = []
        named = False
        for one in self.maps:
            if one.is_pattern or one.ros_name(one.system, one.topic) != name:
                continue
            named = True
            if one.direction in ("both", direction):
                found.append((one.system, one.topic, one))
        if named:
            return found
        system, topic = names_of(name)
        map = self.of(system, topic)
        if map is not None and map.name and map.name != name:
            map = None
        if map is not None and map.direction not in ("both", direction):
            return []
        return [(system, topic, map)]


def ros_name(system: str, topic: str) -> str:
    """Return ``/SYSTEM/TOPIC`` with what ROS does not allow in a name replaced by underscores."""
    whole = topic if system == NO_SYSTEM else f"{system}/{topic}"
    parts = [part for part in _ODD.sub("_", whole).split("/") if part]
    return "/" + "/".join(f"_{part}" if part[:1].isdigit() else part for part in parts)


def names_of(name: str) -> tuple[str, str]:
    """Split a ROS name into system and topic."""
    first, slash, rest = name.lstrip("/").partition("/")
    return (first, rest) if slash else (NO_SYSTEM, first)
