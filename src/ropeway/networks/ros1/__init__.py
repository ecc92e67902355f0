"""The ``ros1`` graph: a ROS 1 master and its nodes over XML-RPC and TCPROS, without a ROS installation."""

from ropeway.networks.ros1.graph import Ros1Graph

__all__ = ["Ros1Graph"]
