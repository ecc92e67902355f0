"""Defines who tells a group which members it has, where they are not known from the start."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol, runtime_checkable

from ropeway.graph.base import Delivery, Graph
from ropeway.graph.signal import Signal

__all__ = ["Connecting", "Roster"]


class Roster(Protocol):
    """Finds the members of a group, which come and go.

    A member is a graph of its own, on which the parts of the group are made anew. ``common`` is the graph that all of
    them are found on: what the group itself offers is offered there, once. ``changed`` is notified when ``members``
    may give others.
    """

    common: Graph
    changed: Signal

    async def open(self) -> None:
        """Open the common graph, and look for members."""

    async def close(self) -> None:
        """Look for members no longer, and close the common graph."""

    def want(self, kind: str, name: str, type: str, delivery: Delivery) -> Callable[[], None]:
        """Look for members that have the other side of a part: of a ``publisher``, ``subscription``, ``client`` or
        ``action``. Return what ends that.
        """

    def members(self) -> Mapping[str, Graph]:
        """Return the members by their names, without waiting."""


@runtime_checkable
class Connecting(Protocol):
    """A graph that comes and goes, and tells."""

    def on_reached(self, callback: Callable[[bool], None]) -> None:
        """Call with whether the far side is reached, now and at each change."""
