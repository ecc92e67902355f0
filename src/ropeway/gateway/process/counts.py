"""Counts of several servers or workers as one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

__all__ = ["summed"]


def summed(many: Iterable[Mapping[str, Mapping[str, int]]]) -> dict[str, dict[str, int]]:
    """Add up counts: ``[{"a": {"x": 1}}, {"a": {"x": 2}}]`` gives ``{"a": {"x": 3}}``."""
    out: dict[str, Counter[str]] = {}
    for one in many:
        for key, counts in one.items():
            out.setdefault(key, Counter()).update(counts)
    return {key: dict(counts) for key, counts in out.items()}
