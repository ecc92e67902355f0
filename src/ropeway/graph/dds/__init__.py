"""The ``dds`` graph: ROS 2 over DDS, with no ROS installed."""

from ropeway.graph.dds.graph import DdsGraph

__all__ = ["DdsGraph"]
