"""The ``zenoh`` graph: ROS 2 over rmw_zenoh, with no ROS installed."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ropeway.networks.zenoh.graph import ZenohGraph

__all__ = ["ZenohGraph"]


def __getattr__(name: str) -> object:
    """Import ``ZenohGraph`` on first use: a configuration reads addresses without Zenoh's library."""
    if name == "ZenohGraph":
        from ropeway.networks.zenoh.graph import ZenohGraph

        return ZenohGraph
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
