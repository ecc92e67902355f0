"""The thread that takes snapshots of the network, whenever something on it changes."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Final

from ropeway.networks.ros2.rcl import Rcl
from ropeway.networks.ros2.snapshot import Marks, Ros2Snapshot, take_picture
from ropeway.tasks import keep_running

__all__ = ["GraphWatcher"]

log = logging.getLogger("ropeway.ros2")

_GAP_S: Final = 0.05  # between two pictures, at least
_SHARE: Final = 0.2  # of a processor, at most
# After a change, names of nodes may come a little later without a word; in the long run nothing should.
_AGAIN_S: Final = (0.25, 1.0, 5.0)


class GraphWatcher:
    """Gives every picture to ``seen``, on the loop."""

    def __init__(
        self, name: str, context: Any, node: Any, rcl: Rcl, marks: Marks, seen: Callable[[Ros2Snapshot], None]
    ) -> None:
        from rclpy.guard_condition import GuardCondition
        from rclpy.impl.implementation_singleton import rclpy_implementation

        self._name, self._context, self._node, self._rcl = name, context, node, rcl
        self._marks, self._seen = marks, seen
        self._rclpy = rclpy_implementation
        self._guard = GuardCondition(None, None, context=context)
        self._loop = asyncio.get_running_loop()
        self._thread = threading.Thread(target=self._main, name=f"ropeway {name} watcher", daemon=True)
        self._ended: asyncio.Future[None] = self._loop.create_future()
        self._stopping = threading.Event()

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def poke(self) -> None:
        """Take a snapshot soon: something changed here."""
        self._guard.trigger()

    async def stop(self) -> None:
        """End the thread."""
        self._stopping.set()
        self._guard.trigger()
        await asyncio.shield(self._ended)
        self._thread.join()
        self._guard.destroy()

    def _main(self) -> None:
        keep_running(self._run, f"{self._name}: the thread that watches ROS 2", self._stopping)
        with contextlib.suppress(RuntimeError):  # the loop closed first
            self._loop.call_soon_threadsafe(_resolve, self._ended)

    def _run(self) -> None:
        with self._context.handle, self._node.handle, self._guard.handle:
            self._watch()

    def _watch(self) -> None:
        wait_set = self._rclpy.WaitSet(0, 2, 0, 0, 0, 0, self._context.handle)
        again = 0
        while not self._stopping.is_set():
            began = time.monotonic()
            try:
                picture = take_picture(self._node, self._marks)
            except RuntimeError as error:
                log.warning("%s: discovery: %s", self._name, error)
            else:
                with contextlib.suppress(RuntimeError):  # the loop was closed under an open graph
                    self._loop.call_soon_threadsafe(self._seen, picture)
            took = time.monotonic() - began
            if self._stopping.wait(max(_GAP_S, took * (1 - _SHARE) / _SHARE)):
                return
            wait_set.clear_entities()
            wait_set.add_guard_condition(self._guard.handle)
            self._rcl.add_graph_guard(wait_set.pointer, self._node.handle.pointer)
            pause_s = _AGAIN_S[min(again, len(_AGAIN_S) - 1)]
            began = time.monotonic()
            wait_set.wait(int(pause_s * 1e9))
            again = again + 1 if time.monotonic() - began >= pause_s else 0


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
