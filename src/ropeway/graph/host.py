"""Defines what the parts of a graph know of it, so that no part imports the graph that makes it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Protocol, TypeVar

from ropeway.graph.base import Undelivered

__all__ = ["Host"]

T = TypeVar("T")


class Host(Protocol):
    """A graph as its publishers, subscriptions, clients and services see it; a network adds what its own parts need."""

    name: str
    drops: Counter[tuple[str, Undelivered]]

    def guard(self, topic: str, callback: Callable[[T], object], value: T) -> None:
        """Run a callback of somebody else's; a failure is logged and counted under ``topic``."""
