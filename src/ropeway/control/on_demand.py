"""Serves a socket from its first connection on: what answers HTTP is loaded then, by gateways that anybody asks."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable
from typing import Protocol

from ropeway.tasks import Supervised

__all__ = ["ClosableServer", "ServedOnDemand"]


class ClosableServer(Protocol):
    """Answers on a socket."""

    async def close(self) -> None:
        """Take no more requests."""
        ...


class ServedOnDemand:
    """Waits for the first connection to ``bound``, which listens, and leaves it to what ``begin`` returns.

    Those that come meanwhile wait in the backlog of the socket. If ``begin`` fails that is logged, and it is called
    again after a pause.
    """

    def __init__(self, bound: socket.socket, begin: Callable[[], Awaitable[ClosableServer]]) -> None:
        self._bound, self._begin = bound, begin
        self._loop = asyncio.get_running_loop()
        self._work: Supervised | None = None
        self._answering: ClosableServer | None = None
        self._waiting = True
        self._loop.add_reader(bound.fileno(), self._came)

    def _came(self) -> None:
        self._stop_waiting()
        self._work = Supervised(self._serve, "begin to answer on the control API").start()

    def _stop_waiting(self) -> None:
        if self._waiting:
            self._waiting = False
            self._loop.remove_reader(self._bound.fileno())

    async def _serve(self) -> None:
        self._answering = await self._begin()

    async def close(self) -> None:
        """End it, whether anybody came or not."""
        self._stop_waiting()
        if self._work is not None:
            await self._work.close()
        if self._answering is not None:
            await self._answering.close()
