"""The ``overlay`` graph: topics, services and actions under names that say nothing about place."""

from ropeway.graph.overlay.graph import OverlayGraph

__all__ = ["OverlayGraph"]
