"""The ``dds`` graph: ROS 2 over DDS, with no ROS installed."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ropeway.networks.dds.graph import DdsGraph

__all__ = ["DdsGraph"]


def __getattr__(name: str) -> object:
    """Import ``DdsGraph`` on first use: other graphs use modules here that need no DDS library."""
    if name == "DdsGraph":
        from ropeway.networks.dds.graph import DdsGraph

        return DdsGraph
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
