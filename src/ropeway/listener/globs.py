"""Limits what rosapi shows by lists of patterns, like rosbridge's ``topics_pub_glob``."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

__all__ = ["Globs"]


@dataclass(frozen=True, slots=True)
class Globs:
    """Shell patterns by kind of name; ``None`` shows every name, an empty list none.

    ``topics_pub`` and ``topics_sub`` are the topics that clients may publish and read: rosapi lists what is in either,
    and everything where one of them is ``None``. ``params`` are names of parameters, without their nodes.
    """

    topics_pub: Sequence[str] | None = None
    topics_sub: Sequence[str] | None = None
    services: Sequence[str] | None = None
    params: Sequence[str] | None = None
    actions: Sequence[str] | None = None

    @property
    def topics(self) -> Sequence[str] | None:
        """The patterns of topics that are published or read."""
        if self.topics_pub is None or self.topics_sub is None:
            return None
        return (*self.topics_pub, *self.topics_sub)

    @staticmethod
    def allows(name: str, patterns: Iterable[str] | None) -> bool:
        """Return whether ``name`` is shown."""
        return patterns is None or any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)
