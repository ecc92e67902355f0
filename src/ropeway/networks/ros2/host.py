"""Defines what the parts of a ``ros2`` graph need of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from ropeway.graph.host import Host

if TYPE_CHECKING:
    from ropeway.graph.layout_border import Border
    from ropeway.networks.ros2.participant import Ros2Participant

__all__ = ["Ros2Host"]


class Ros2Host(Host, Protocol):
    """The graph, as all of its parts see it; each adds what it alone needs."""

    @property
    def border(self) -> Border:
        """The types of the network."""
        ...

    @property
    def participant(self) -> Ros2Participant:
        """The side of rclpy. Raises ``GraphUnavailable`` where the graph is not open."""
        ...
