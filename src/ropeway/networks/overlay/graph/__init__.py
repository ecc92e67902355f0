"""The ``overlay`` graph: topics, services and actions under names that say nothing about place."""

from ropeway.networks.overlay.graph.graph import OverlayGraph

__all__ = ["OverlayGraph"]
