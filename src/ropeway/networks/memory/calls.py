"""Services of the ``memory`` graph: a call runs the handler of the first participant that serves the name."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Protocol

from ropeway.errors import CallTimeout, NotServed, ProviderLost
from ropeway.graph.base import new_origin
from ropeway.graph.calls import Request, ServiceHandler
from ropeway.graph.host import Host
from ropeway.graph.local_calls import LEFT, InFlight, answer
from ropeway.graph.parts import ClientBase

__all__ = ["MemoryCallHost", "MemoryClient", "MemoryService"]


class MemoryCallHost(Host, Protocol):
    """The services of a graph for the services that it serves."""

    node: str

    def provider(self, service: str, type: str) -> MemoryService | None:
        """Return who of the other participants answers calls."""
        ...

    def withdraw(self, part: MemoryService | MemoryClient) -> None:
        """Forget a part that was closed, and tell the others."""
        ...


class MemoryService:
    """A service served on a ``MemoryGraph``."""

    def __init__(self, graph: MemoryCallHost, service: str, type: str, handler: ServiceHandler) -> None:
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
        """See ``Service.close``."""
        if self.closed:
            return
        self.closed = True
        self.graph.withdraw(self)
        await self._running.fail(ProviderLost(self.service, LEFT))


class MemoryClient(ClientBase[MemoryCallHost]):
    """A service called on a ``MemoryGraph``."""

    def __init__(self, graph: MemoryCallHost, service: str, type: str) -> None:
        super().__init__(graph, service, type)
        self.graph = graph
        self.gid = new_origin()

    @property
    def available(self) -> bool:
        """Return whether another participant serves it now."""
        return not self.closed and self.graph.provider(self.service, self.type) is not None

    async def _call(self, request: Request, timeout_s: float) -> bytes:
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        await self.wait_available(timeout_s)
        provider = self.graph.provider(self.service, self.type)
        if provider is None:
            raise NotServed(self.service)
        left_s = deadline - loop.time()
        if left_s <= 0:
            raise CallTimeout(self.service, timeout_s)
        return await provider.answer(replace(request, timeout_s=left_s), left_s)

    async def _leave(self) -> None:
        self.graph.withdraw(self)
