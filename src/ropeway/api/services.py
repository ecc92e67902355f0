"""Clients and services for programs."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING

from ropeway.api.message import MessageType, TypedMessage
from ropeway.api.part import Part
from ropeway.errors import NotServed
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Request
from ropeway.types import TypeRegistry

if TYPE_CHECKING:
    from ropeway.hub.calls import ViewClient, ViewService
    from ropeway.hub.hub import View

__all__ = ["AsyncClient", "AsyncService", "RequestHandler", "service_messages"]

RequestHandler = Callable[[TypedMessage], object | Awaitable[object]]
"""Returns the response to a request, in any form that ``AsyncPublisher.publish`` takes; may be a coroutine function."""


class AsyncClient(Part):
    """A service that a program calls; ``AsyncGraph.client`` makes it.

    Any number of calls may be under way; ``close`` fails them with ``GraphUnavailable``.
    """

    def __init__(self, view: View, inner: ViewClient, request: MessageType, response: MessageType, caller: str) -> None:
        super().__init__(view)
        self.service, self.type = inner.service, inner.type
        self._inner = inner
        self._request, self._response = request, response
        self._caller = caller

    @property
    def available(self) -> bool | None:
        """Return whether somebody serves it now, ``None`` where the network cannot tell before a call."""
        return self._inner.available

    async def wait_available(self, *, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        """Wait until somebody serves it; return at once where the network cannot tell. Raises ``NotServed``."""
        if self.available is False and not await self._inner.wait_available(timeout_s):
            raise NotServed(self.service)

    async def call(self, request: object = None, *, timeout_s: float = DEFAULT_TIMEOUT_S) -> TypedMessage:
        """Return the response to ``request``, given in any form that ``AsyncPublisher.publish`` takes.

        ``timeout_s`` bounds the wait for a provider and its response. Raises ``ValueMismatch`` if the request does not
        fit, ``NotServed``, ``CallTimeout``, ``ProviderLost``, or ``CallFailed`` with what the provider says.
        """
        raw = self._request.encode(request)
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        await self.wait_available(timeout_s=timeout_s)
        left_s = max(deadline - loop.time(), 0.001)
        return self._response.message(await self._inner.call(Request(raw, caller=self._caller), left_s))


class AsyncService(Part):
    """A service that a program offers; ``AsyncGraph.serve`` makes it.

    Calls run at the same time; ``close`` fails them with ``ProviderLost`` where the network can say so.
    """

    def __init__(self, view: View, request: MessageType, response: MessageType, handler: RequestHandler) -> None:
        super().__init__(view)
        self._handler = handler
        self._request, self._response = request, response
        self._inner: ViewService | None = None

    def attach(self, inner: ViewService) -> None:
        """Follow the service on the graph."""
        self._inner = inner

    async def answer(self, request: Request) -> bytes:
        """Answer a call; what the handler raises fails it."""
        response = self._handler(self._request.message(request.payload))
        if inspect.isawaitable(response):
            response = await response
        return self._response.encode(response)

    @property
    def service(self) -> str:
        """Return its name."""
        assert self._inner is not None
        return self._inner.service

    @property
    def type(self) -> str:
        """Return its type, such as ``std_srvs/srv/SetBool``."""
        assert self._inner is not None
        return self._inner.type

    @property
    def taken_by(self) -> str:
        """Return who else serves the name, until which leaves this one waits; ``""`` while it serves."""
        assert self._inner is not None
        return self._inner.taken_by


def service_messages(registry: TypeRegistry, type: str) -> tuple[MessageType, MessageType]:
    """Return the types of requests and responses of a service. Raises ``UnknownType``."""
    return MessageType(registry, f"{type}_Request"), MessageType(registry, f"{type}_Response")
