"""Finds out whether a server's clients are those of a ROS 1 network."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from ropeway.graph.base import Graph
    from ropeway.types.ros1_spelling import Ros1Spelling

__all__ = ["ros1_spelling"]


@runtime_checkable
class _SpeaksRos1(Protocol):
    """A graph of ROS 1, whose clients expect messages as ROS 1 writes them."""

    @property
    def ros1_spelling(self) -> Ros1Spelling: ...


def ros1_spelling(graph: Graph) -> Ros1Spelling | None:
    """Return the spelling of messages of ``graph`` for web clients; ``None`` for anything but ROS 1."""
    return graph.ros1_spelling if isinstance(graph, _SpeaksRos1) else None
