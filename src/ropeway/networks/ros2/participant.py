"""A context, a node and the threads of one graph."""

from __future__ import annotations

import asyncio
import logging
import os
import threading
from collections.abc import Callable
from typing import Any, Final

from ropeway.errors import GraphUnavailable
from ropeway.networks.ros2.environment import rclpy_fault
from ropeway.networks.ros2.interfaces import message_class
from ropeway.networks.ros2.rcl import Rcl
from ropeway.networks.ros2.senders import Senders
from ropeway.networks.ros2.snapshot import MARK_TYPE, Marks, Ros2Snapshot, mark_topic
from ropeway.networks.ros2.spinner import Spinner
from ropeway.networks.ros2.watcher import GraphWatcher

__all__ = ["Ros2Participant"]

log = logging.getLogger("ropeway.ros2")

_OPTIONS: Final = {
    "cli_args": [],
    "use_global_arguments": False,
    "enable_rosout": False,
    "start_parameter_services": False,
}


class Ros2Participant:
    """The node ``node`` in domain ``domain``, with a context of its own, so that graphs do not share anything."""

    def __init__(self, name: str, domain: int, node: str, gateway_id: str) -> None:
        self.name, self.domain = name, domain
        self.rmw = ""
        self.node: Any = None
        self.context: Any = None
        self.rcl: Rcl
        self.invalid_handle: type[Exception] = RuntimeError
        self.senders = Senders(name)
        self.spinner: Spinner
        self.watcher: GraphWatcher
        self._full_name = node
        self._gateway_id = gateway_id
        self._instance = os.urandom(8).hex()
        self._joining = threading.Lock()

    async def open(self, seen: Callable[[Ros2Snapshot], None]) -> None:
        """Join; ``seen`` gets what is discovered. Raises ``GraphUnavailable`` with what to do."""
        fault = await asyncio.to_thread(rclpy_fault)
        if fault:
            raise GraphUnavailable(self.name, fault)
        try:
            await asyncio.to_thread(self._join)
            self.spinner = Spinner(self.name, self.context)
            marks = Marks.of(self._instance, self._full_name, self._gateway_id, self.rmw)
            self.watcher = GraphWatcher(self.name, self.context, self.node, self.rcl, marks, seen)
        except (RuntimeError, ValueError, OSError) as error:
            await asyncio.to_thread(self._leave)
            raise GraphUnavailable(self.name, f"ROS 2 does not start: {str(error).splitlines()[0]}") from error
        except BaseException:
            await asyncio.to_thread(self._leave)
            raise
        self.spinner.start()
        self.watcher.start()

    async def close(self) -> None:
        """Leave, with everything that was created here."""
        await self.senders.stop()
        await self.watcher.stop()
        await self.spinner.stop()
        await asyncio.to_thread(self._leave)

    def _join(self) -> None:
        with self._joining:
            self._create()

    def _create(self) -> None:
        from rclpy.context import Context
        from rclpy.impl.implementation_singleton import rclpy_implementation
        from rclpy.node import Node
        from rclpy.parameter import Parameter
        from rclpy.utilities import get_rmw_implementation_identifier

        self.rcl = Rcl()
        self.invalid_handle = rclpy_implementation.InvalidHandle
        self.rmw = get_rmw_implementation_identifier()
        self.context = Context()
        self.context.init(args=[], initialize_logging=False, domain_id=self.domain)
        namespace, _, name = self._full_name.rpartition("/")
        quiet = Parameter("start_type_description_service", Parameter.Type.BOOL, False)  # nobody would answer it
        self.node = Node(
            name, context=self.context, namespace=namespace or "/", parameter_overrides=[quiet], **_OPTIONS
        )
        mark = message_class(MARK_TYPE)
        self.node.create_publisher(mark, mark_topic(self._gateway_id, self._instance), 1)

    def _leave(self) -> None:
        with self._joining:  # where ``open`` was cancelled, its thread may still be at it
            node, self.node = self.node, None
            context, self.context = self.context, None
        if node is not None:
            node.destroy_node()
        if context is not None:
            context.try_shutdown()
