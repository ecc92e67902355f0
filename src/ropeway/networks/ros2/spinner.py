"""The thread that waits for ROS 2 and hands over to the event loop.

It sleeps in a wait set of rclpy. What is ready has its handler run there; handlers ``push`` batches for functions of
the loop. Where there is no ``room``, subscriptions are left out of the wait set, so that the middleware applies their
profiles, until the loop has caught up.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

from ropeway.graph.hand_over import HandOver
from ropeway.tasks import keep_running

__all__ = ["Spinner"]

log = logging.getLogger("ropeway.ros2")

_FOREVER: Final = -1


@dataclass(slots=True, eq=False)
class _Entry:
    kind: str
    handle: Any
    handler: Callable[[], None]


class Spinner(HandOver):
    """Waits on ``subscription``, ``client`` and ``service`` handles of a context."""

    def __init__(self, name: str, context: Any) -> None:
        from rclpy.guard_condition import GuardCondition
        from rclpy.impl.implementation_singleton import rclpy_implementation

        super().__init__(name)
        self._context = context
        self._rclpy = rclpy_implementation
        self._guard = GuardCondition(None, None, context=context)
        self._thread = threading.Thread(target=self._main, name=f"ropeway {name}", daemon=True)
        self._ended: asyncio.Future[None] = self._loop.create_future()
        self._ending = threading.Event()
        self._entries: dict[int, _Entry] = {}
        self._version = 0
        self._lock = threading.Lock()

    # On the loop ------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    async def stop(self) -> None:
        """End the thread. What was pushed and not yet run is dropped."""
        self._stopping = True
        self._ending.set()
        self._wake()
        await asyncio.shield(self._ended)
        self._thread.join()
        self._out.clear()
        self._guard.destroy()

    def add(self, kind: str, handle: Any, handler: Callable[[], None]) -> None:
        """Run ``handler`` in the thread whenever there is something to take from ``handle``."""
        with self._lock:
            self._entries[handle.pointer] = _Entry(kind, handle, handler)
            self._version += 1
        self._wake()

    def remove(self, handle: Any) -> None:
        """Forget a handle, which is destroyed next."""
        with self._lock:
            known = [pointer for pointer, entry in self._entries.items() if entry.handle is handle]
            for pointer in known:
                del self._entries[pointer]
            self._version += 1
        self._wake()

    # In the thread ----------------------------------------------------------------------------------------------

    def _main(self) -> None:
        keep_running(self._run, f"{self._name}: the thread that waits for ROS 2", self._ending)
        with contextlib.suppress(RuntimeError):  # the loop closed first
            self._loop.call_soon_threadsafe(_resolve, self._ended)

    def _run(self) -> None:
        while not self._stopping:
            with self._entered() as (version, entries):
                self._spin(version, entries)

    @contextlib.contextmanager
    def _entered(self) -> Iterator[tuple[int, list[_Entry]]]:
        """Provide the current entries, which cannot be destroyed meanwhile."""
        with self._lock:
            version, wanted = self._version, list(self._entries.values())
        with contextlib.ExitStack() as held:
            entries = []
            held.enter_context(self._context.handle)
            held.enter_context(self._guard.handle)
            for entry in wanted:
                with contextlib.suppress(self._rclpy.InvalidHandle):
                    held.enter_context(entry.handle)
                    entries.append(entry)
            yield version, entries

    def _spin(self, version: int, entries: list[_Entry]) -> None:
        """Wait and handle until the entries change."""
        of = {kind: [e for e in entries if e.kind == kind] for kind in ("subscription", "client", "service")}
        by_pointer = {entry.handle.pointer: entry for entry in entries}
        counts = (len(of["subscription"]), 1, 0, len(of["client"]), len(of["service"]), 0)
        wait_set = self._rclpy.WaitSet(*counts, self._context.handle)
        subscriptions = [entry.handle for entry in of["subscription"]]
        clients = [entry.handle for entry in of["client"]]
        services = [entry.handle for entry in of["service"]]
        while version == self._version and not self._stopping:
            wait_set.clear_entities()
            wait_set.add_guard_condition(self._guard.handle)
            self._starved = True  # before looking, so that a loop that catches up now wakes us
            if self.room:
                self._starved = False
                for handle in subscriptions:
                    wait_set.add_subscription(handle)
            for handle in clients:
                wait_set.add_client(handle)
            for handle in services:
                wait_set.add_service(handle)
            wait_set.wait(_FOREVER)
            for kind, all_of_kind in of.items():
                if all_of_kind:
                    for pointer in wait_set.get_ready_entities(kind):
                        self._handle(by_pointer[pointer])

    def _handle(self, entry: _Entry) -> None:
        """Run one handler; one that fails is not run again, and costs the others nothing."""
        if self._entries.get(entry.handle.pointer) is not entry:
            return
        try:
            entry.handler()
        except Exception:  # of one endpoint; the others are read as ever
            log.exception("%s: taking from a %s failed; it is dead", self._name, entry.kind)
            with self._lock:
                self._entries.pop(entry.handle.pointer, None)
                self._version += 1

    def _wake(self) -> None:
        self._guard.trigger()


def _resolve(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)
