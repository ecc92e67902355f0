"""Maintains a bridge while both networks change; a failure is shown in its state and retried."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Final

from ropeway import aio
from ropeway.errors import RopewayError
from ropeway.graph.base import Graph, GraphEvent
from ropeway.tasks import Supervised, describe, end

__all__ = ["RETRY_S", "Upkeep"]

log = logging.getLogger("ropeway.bridge")

RETRY_S: Final = 2.0  # a side that refused is asked again
_LONGEST_RETRY_S: Final = 30.0  # one that fails in a way that nobody foresaw, more and more rarely


class Upkeep:
    """Runs ``set_right`` when woken, when ``source`` tells of a ``kind`` called ``name``, and again after a failure.

    ``look_s``: run it so often even if nothing is told. ``label`` names the bridge in the log.
    """

    def __init__(
        self,
        set_right: Callable[[], Awaitable[None]],
        source: Graph,
        kind: str,
        name: str,
        *,
        label: str,
        look_s: float | None = None,
        retry_s: float = RETRY_S,
    ) -> None:
        self._error = ""
        self._set_right, self._source = set_right, source
        self._kind, self._name, self._label = kind, name, label
        self._look_s, self._retry_s, self._first_retry_s = look_s, retry_s, retry_s
        self._changed = asyncio.Event()
        self._watch = Supervised(lambda: self._listen(source.changes()), f"watch {kind} {name}", pause_s=retry_s)
        self._keep = Supervised(self._run, f"bridge {kind} {name}")

    def start(self) -> None:
        """Set it right now, and from now on."""
        self._changed.set()
        self._watch.start()
        self._keep.start()

    async def close(self) -> None:
        """Leave it as it is."""
        await end(self._watch, self._keep)

    @property
    def error(self) -> str:
        """Return why it is not right, ``""`` while it is."""
        return self._error or self._watch.error or self._keep.error

    def wake(self) -> None:
        """Schedule maintenance soon."""
        self._changed.set()

    async def _listen(self, changes: AsyncIterator[GraphEvent]) -> None:
        self._changed.set()  # what came before, or while nobody listened
        async for event in changes:
            if event.kind == self._kind and event.name == self._name:
                self._changed.set()

    async def _run(self) -> None:
        while True:
            with contextlib.suppress(TimeoutError):
                async with aio.timeout(self._retry_s if self._error else self._look_s):
                    await self._changed.wait()
            self._changed.clear()
            try:
                await self._set_right()
            except RopewayError as error:
                self._failed(error, logging.WARNING)
                self._retry_s = self._first_retry_s
            except Exception as error:  # of a graph, or of ours: this bridge alone is held up by it
                self._failed(error, logging.ERROR)
                self._retry_s = min(2 * self._retry_s, _LONGEST_RETRY_S)
            else:
                self._error = ""
                self._retry_s = self._first_retry_s

    def _failed(self, error: Exception, level: int) -> None:
        text = describe(error)
        if text != self._error:
            unforeseen = error if level == logging.ERROR else None
            log.log(level, "%s: %s", self._label, text, exc_info=unforeseen)
        self._error = text
