"""Actions composed of a graph's own services and topics, exactly as ROS 2 composes them.

Graphs whose network knows no actions of its own (``memory``, ``dds``, ``ros2``) make their action clients and servers
here: three services and two topics below ``<action>/_action/``.
"""

from ropeway.graph.actions.client import ComposedActionClient
from ropeway.graph.actions.parts import ActionParts, action_of_service, actions_of, service_of_action
from ropeway.graph.actions.server import ComposedActionServer

__all__ = [
    "ActionParts",
    "ComposedActionClient",
    "ComposedActionServer",
    "action_of_service",
    "actions_of",
    "service_of_action",
]
