"""A thread for big messages: putting one of them on the network takes longer than the event loop should wait."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import queue
import threading
from collections.abc import Callable

__all__ = ["Courier"]

log = logging.getLogger("ropeway.dds")


class Courier:
    """Runs what it is given in one thread, in order. The thread is there from the first errand to ``stop``."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._errands: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def submit(self, errand: Callable[[], None]) -> None:
        """Run ``errand`` after those before it; one that fails costs the others nothing."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._main, name=f"ropeway {self._name} courier", daemon=True)
            self._thread.start()
        self._errands.put(errand)

    async def flush(self) -> None:
        """Wait until all errands so far are done."""
        if self._thread is None:
            return
        loop = asyncio.get_running_loop()
        done = loop.create_future()

        def tell() -> None:
            with contextlib.suppress(RuntimeError):  # the loop closed first
                loop.call_soon_threadsafe(_resolve, done)

        self._errands.put(tell)
        await done

    async def stop(self) -> None:
        """Wait until all errands are done, and end the thread."""
        await self.flush()
        thread, self._thread = self._thread, None
        if thread is not None:
            self._errands.put(None)
            thread.join()

    def _main(self) -> None:
        while (errand := self._errands.get()) is not None:
            try:
                errand()
            except Exception:  # of one message; the next ones are written
                log.exception("%s: putting a message on the network failed", self._name)


def _resolve(done: asyncio.Future[None]) -> None:
    if not done.done():
        done.set_result(None)
