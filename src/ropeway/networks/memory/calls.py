"""Services of the ``memory`` graph: a call runs the handler of the first participant that serves the name."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import TYPE_CHECKING

from ropeway import aio
from ropeway.errors import CallTimeout, GraphUnavailable, NotServed, ProviderLost
from ropeway.graph.base import new_origin
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Request, ServiceHandler
from ropeway.graph.local_calls import LEFT, InFlight, answer

if TYPE_CHECKING:
    from ropeway.networks.memory.graph import MemoryGraph

__all__ = ["MemoryClient", "MemoryService"]


class MemoryService:
    """A service served on a ``MemoryGraph``."""

    def __init__(self, graph: MemoryGraph, service: str, type: str, handler: ServiceHandler) -> None:
        self.service, self.type, self.graph = service, type, graph
        self.gid = new_origin()
        self.closed = False
        self._handler = handler
        self._running = InFlight()

    async def answer(self, request: Request, timeout_s: float) -> bytes:
        """Run the handler for a call. Raises ``CallError``."""
        return await answer(self.service, self._running, self._handle(request), timeout_s)

    async def _handle(self, request: Request) -> bytes:
        return bytes(await self._handler(request))

    async def close(self) -> None:
        """See ``Service``."""
        if self.closed:
            return
        self.closed = True
        self.graph.network.services.remove(self.service, self)
        self.graph.announce_service(self, False)
        await self._running.fail(ProviderLost(self.service, LEFT))


class MemoryClient:
    """A service called on a ``MemoryGraph``."""

    def __init__(self, graph: MemoryGraph, service: str, type: str) -> None:
        self.service, self.type, self.graph = service, type, graph
        self.gid = new_origin()
        self.closed = False
        self._came = asyncio.Event()
        self._under_way = InFlight()

    def look(self) -> None:
        """Check for a provider after a service has appeared somewhere."""
        if self.provider() is not None:
            self._came.set()

    def provider(self) -> MemoryService | None:
        """Return the first service of another participant with this name and type."""
        for service in self.graph.network.services.of(self.service):
            if service.type == self.type and service.graph is not self.graph:
                return service
        return None

    @property
    def available(self) -> bool:
        """Whether a provider serves it now."""
        return not self.closed and self.provider() is not None

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``Client``."""
        try:
            async with aio.timeout(timeout_s):
                while not self.closed and not self.available:
                    self._came.clear()
                    await self._came.wait()
        except TimeoutError:
            return False
        return self.available

    async def call(self, request: Request, timeout_s: float = DEFAULT_TIMEOUT_S) -> bytes:
        """See ``Client``."""
        if self.closed:
            raise GraphUnavailable(self.graph.name, f"the client of {self.service} is closed")
        with self._under_way.call():
            return await self._call(request, timeout_s)

    async def _call(self, request: Request, timeout_s: float) -> bytes:
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        if not await self.wait_available(timeout_s) or (provider := self.provider()) is None:
            raise NotServed(self.service)
        left_s = deadline - loop.time()
        if left_s <= 0:
            raise CallTimeout(self.service, timeout_s)
        return await provider.answer(replace(request, timeout_s=left_s), left_s)

    async def close(self) -> None:
        """See ``Client``."""
        if self.closed:
            return
        self.closed = True
        self._came.set()
        self.graph.network.clients.remove(self.service, self)
        why = f"the client of {self.service} was closed in mid-call"
        await self._under_way.fail(GraphUnavailable(self.graph.name, why))
