"""Says what viewers may see and do beside their roles, in the words of foxglove_bridge."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

__all__ = ["ASSET_PATTERN", "CAPABILITIES", "FoxgloveSettings", "patterns"]

CAPABILITIES: Final = (
    "clientPublish",
    "parameters",
    "parametersSubscribe",
    "services",
    "connectionGraph",
    "assets",
)
"""The parts of the protocol that can be left out."""

ASSET_PATTERN: Final = (
    r"^package://(?:[-\w%]+/)*[-\w%.]+\."
    r"(?:dae|fbx|glb|gltf|jpeg|jpg|mtl|obj|png|stl|tif|tiff|urdf|webp|xacro)$"
)
"""The files that viewers may fetch unless other patterns are given: models, textures and descriptions of robots."""

Patterns = Sequence[re.Pattern[str]]


def patterns(texts: Sequence[str]) -> tuple[re.Pattern[str], ...]:
    """Compile regular expressions. Raises ``re.error``."""
    return tuple(re.compile(text) for text in texts)


_ALL: Final = patterns((".*",))


@dataclass(frozen=True)
class FoxgloveSettings:
    """The part of the graph that viewers see, and how much of it waits for them.

    The lists of patterns have to match a whole name. ``best_effort`` names topics that are read as best effort
    whatever is offered; of every other the profile of its publishers is adopted. A viewer has ``min_depth`` to
    ``max_depth`` messages of a topic waiting, and ``send_buffer_bytes`` in all. ``asset_roots`` are directories that
    hold packages; without one there are no assets. ``sim_time`` tells viewers the time of ``/clock``.
    """

    topics: Patterns = _ALL
    services: Patterns = _ALL
    params: Patterns = _ALL
    client_topics: Patterns = _ALL
    best_effort: Patterns = ()
    min_depth: int = 1
    max_depth: int = 25
    send_buffer_bytes: int = 10_000_000
    sim_time: bool = False
    capabilities: frozenset[str] = field(default_factory=lambda: frozenset(CAPABILITIES))
    include_hidden: bool = False
    asset_roots: Sequence[Path] = ()
    asset_uris: Patterns = field(default_factory=lambda: patterns((ASSET_PATTERN,)))

    def shows_topic(self, name: str) -> bool:
        """Return whether viewers see a topic."""
        return self._shows(name) and _matches(name, self.topics)

    def shows_service(self, name: str) -> bool:
        """Return whether viewers see a service."""
        return self._shows(name) and _matches(name, self.services)

    def shows_param(self, name: str) -> bool:
        """Return whether viewers see a parameter, named with its node."""
        return _matches(name, self.params)

    def takes_topic(self, name: str) -> bool:
        """Return whether viewers may publish a topic."""
        return _matches(name, self.client_topics)

    def reads_best_effort(self, name: str) -> bool:
        """Return whether a topic is read as best effort whatever is offered."""
        return _matches(name, self.best_effort)

    def serves_asset(self, uri: str) -> bool:
        """Return whether viewers may fetch a file of this name."""
        return _matches(uri, self.asset_uris)

    def depth(self, offered: int) -> int:
        """Return how many messages of a topic may wait for a viewer, given the depth of its publishers."""
        return max(min(offered, self.max_depth), self.min_depth, 1)

    def _shows(self, name: str) -> bool:
        return self.include_hidden or "/_" not in name


def _matches(name: str, among: Patterns) -> bool:
    return any(pattern.fullmatch(name) for pattern in among)
