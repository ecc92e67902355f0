"""The ``ros2`` graph: a network of ROS 2 through the rclpy of the sourced environment, whatever middleware it uses.

rclpy is imported when such a graph is opened, and not before.
"""

from ropeway.networks.ros2.environment import rclpy_fault
from ropeway.networks.ros2.graph import Ros2Graph

__all__ = ["Ros2Graph", "rclpy_fault"]
