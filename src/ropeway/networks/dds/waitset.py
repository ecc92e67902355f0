"""The one thread of a participant: it waits for DDS, takes, and hands over to the event loop.

The thread sleeps in a WaitSet. What triggers runs its handler there; handlers ``push`` batches for functions of the
loop. Where there is no ``room`` they leave their data with DDS, and are run again when the loop has caught up. Where
very many samples come it rests before it waits for more (``Moderation``).
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes as ct
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final, TypeVar

from ropeway.errors import GraphUnavailable
from ropeway.graph.hand_over import HandOver
from ropeway.graph.moderation import REST_S, Moderation
from ropeway.networks.dds.raw import INFINITY, SAMPLES_PER_TAKE, check, lib
from ropeway.tasks import keep_running

__all__ = ["Pump", "run_in_thread"]

log = logging.getLogger("ropeway.dds")

_MAX_TRIGGERS: Final = 256
_GUARD_KEY: Final = 0
_LONGEST_PAUSE_S: Final = 2.0  # calls of the loop wait for the thread

T = TypeVar("T")


class Pump(HandOver):
    """Runs handlers in a thread of its own and functions on ``loop``.

    ``setup`` runs first in the thread and gives the participant's entity; ``teardown`` runs last. ``start`` and
    ``stop`` are awaited on the loop, so that nothing slow of DDS ever blocks it.
    """

    def __init__(self, name: str, setup: Callable[[], int], teardown: Callable[[], None]) -> None:
        super().__init__(name)
        self._setup, self._teardown = setup, teardown
        self._thread = threading.Thread(target=self._main, name=f"ropeway {name}", daemon=True)
        self._started: asyncio.Future[None] = self._loop.create_future()
        self._stopped: asyncio.Future[None] = self._loop.create_future()
        self._stopped.add_done_callback(lambda _: self._run_calls())  # one that came as the thread ended
        self._ending = threading.Event()
        self._waitset = 0
        self._guard = 0
        self._keys = _GUARD_KEY
        self._handlers: dict[int, tuple[Callable[[], None], int]] = {}
        self._calls: deque[Callable[[], None]] = deque()
        self._backlog: dict[Callable[[], None], None] = {}

    # On the loop ------------------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Start the thread and wait until ``setup`` is through; raises what it raised."""
        self._thread.start()
        try:
            await self._started
        except BaseException:
            self._stopping = True
            self._wake()
            await self._join()
            raise

    async def stop(self) -> None:
        """Run ``teardown`` in the thread and wait for its end. What was pushed and not yet run is dropped."""
        self._stopping = True
        self._ending.set()
        self._wake()
        await self._join()

    def attach(self, entity: int, handler: Callable[[], None]) -> int:
        """Run ``handler`` in the thread whenever ``entity`` triggers; gives the key for ``detach``."""
        self._keys += 1
        key = self._keys
        self._handlers[key] = (handler, entity)
        check(lib.waitset_attach(self._waitset, entity, key), "waitset_attach")
        return key

    def detach(self, key: int) -> None:
        """Forget a handler; deleting its entity takes it from the WaitSet."""
        self._handlers.pop(key, None)

    def call(self, function: Callable[[], T]) -> asyncio.Future[T]:
        """Run ``function`` in the thread; the future gives what it returned or raised."""
        future: asyncio.Future[T] = self._loop.create_future()
        if self._stopping:
            future.set_exception(GraphUnavailable(self._name, "was closed"))
            return future

        def run() -> None:
            try:
                result = function()
            except Exception as error:  # whoever waits for the function gets its error
                self.push(_fail, [(future, error)])
            else:
                self.push(_succeed, [(future, result)])

        self._calls.append(run)
        self._wake()
        return future

    @property
    def stopped(self) -> bool:
        """Whether the thread has ended, or is about to."""
        return self._stopping

    # In the thread ----------------------------------------------------------------------------------------------

    def again(self, handler: Callable[[], None]) -> None:
        """Run ``handler`` once there is room."""
        self._backlog[handler] = None

    def _main(self) -> None:
        try:
            participant = self._setup()
            self._waitset = check(lib.create_waitset(participant), "create_waitset")
            self._guard = check(lib.create_guardcondition(participant), "create_guardcondition")
            check(lib.waitset_attach(self._waitset, self._guard, _GUARD_KEY), "waitset_attach")
        except BaseException as error:  # whatever it is: who waits for the start of the thread learns of it
            self._finish(error)
            return
        self._tell(self._started, None)
        keep_running(self._run, f"{self._name}: the DDS thread", self._ending, longest_pause_s=_LONGEST_PAUSE_S)
        self._finish(None)

    def _run(self) -> None:
        triggers = (ct.c_ssize_t * _MAX_TRIGGERS)()
        handlers, waitset, wait = self._handlers, self._waitset, lib.waitset_wait
        moderation = Moderation(self._pushed_samples)
        self._run_calls()  # after a failure: what was asked for meanwhile
        while not self._stopping:
            count = wait(waitset, triggers, _MAX_TRIGGERS, INFINITY)
            if count < 0:
                check(count, "waitset_wait")
            before = self._pushed_samples
            for key in triggers[: min(count, _MAX_TRIGGERS)]:
                if key == _GUARD_KEY:
                    self._on_guard()
                elif (found := handlers.get(key)) is not None:
                    handler, entity = found
                    try:
                        handler()
                    except Exception:  # of one endpoint; the others are read as ever, and it is not read again
                        log.exception("%s: reading from DDS failed; this endpoint is dead", self._name)
                        handlers.pop(key, None)
                        lib.waitset_detach(waitset, entity)
            if self._backlog:
                self._catch_up()
            if self._pushed_samples >= moderation.next_look:
                moderation.look(self._pushed_samples)
            if moderation.rests and 0 < self._pushed_samples - before < SAMPLES_PER_TAKE:  # or there may be more
                time.sleep(REST_S)

    def _on_guard(self) -> None:
        was_set = ct.c_bool()
        check(lib.take_guardcondition(self._guard, ct.byref(was_set)), "take_guardcondition")
        self._run_calls()

    def _run_calls(self) -> None:
        while self._calls:
            self._calls.popleft()()

    def _catch_up(self) -> None:
        """Run handlers that wait for room; where there is none, have the loop wake us once it has drained."""
        self._starved = True
        if not self.room:
            return
        self._starved = False
        waiting, self._backlog = self._backlog, {}
        for handler in waiting:
            try:
                handler()
            except Exception:  # of one endpoint; the others are read as ever
                log.exception("%s: delivering what waited failed", self._name)
        if self._backlog:
            self._starved = True
            if self.room:
                self._wake()

    def _finish(self, error: BaseException | None) -> None:
        self._stopping = True
        try:
            self._run_calls()
            self._teardown()
        except Exception:  # the thread ends all the same
            log.exception("%s: closing failed", self._name)
        if error is not None:
            self._tell(self._started, error)
        self._tell(self._stopped, None)

    def _tell(self, future: asyncio.Future[None], error: BaseException | None) -> None:
        try:
            if error is None:
                self._loop.call_soon_threadsafe(_succeed, [(future, None)])
            else:
                self._loop.call_soon_threadsafe(_fail, [(future, error)])
        except RuntimeError:
            log.debug("%s: the event loop closed first", self._name)

    # Between the two --------------------------------------------------------------------------------------------

    def _wake(self) -> None:
        if self._guard:
            lib.set_guardcondition(self._guard, True)

    async def _join(self) -> None:
        await asyncio.shield(self._stopped)
        self._thread.join()
        self._out.clear()


def _succeed(pairs: list[tuple[asyncio.Future[Any], Any]]) -> None:
    for future, result in pairs:
        if not future.done():
            future.set_result(result)


def _fail(pairs: list[tuple[asyncio.Future[Any], BaseException]]) -> None:
    for future, error in pairs:
        if not future.done():
            future.set_exception(error)


async def run_in_thread(name: str, function: Callable[[], None]) -> None:
    """Run ``function`` in a thread of its own and wait for its end; raises what it raised."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[None] = loop.create_future()

    def run() -> None:
        failure: BaseException | None = None
        try:
            function()
        except Exception as error:  # whoever waits for the function gets its error
            failure = error
        with contextlib.suppress(RuntimeError):  # the loop closed first
            if failure is None:
                loop.call_soon_threadsafe(_succeed, [(done, None)])
            else:
                loop.call_soon_threadsafe(_fail, [(done, failure)])

    thread = threading.Thread(target=run, name=name, daemon=True)
    thread.start()
    try:
        await done
    finally:
        if done.done() and not done.cancelled():
            thread.join()
