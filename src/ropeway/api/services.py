"""Clients and services for programs."""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING

from ropeway.api.calls import OfferPart, UserPart
from ropeway.api.message import MessageType, TypedMessage
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Request
from ropeway.hub.calls import ViewClient, ViewService
from ropeway.types import TypeRegistry

if TYPE_CHECKING:
    from ropeway.hub.hub import View

__all__ = ["AsyncClient", "AsyncService", "RequestHandler", "service_messages"]

RequestHandler = Callable[[TypedMessage], object | Awaitable[object]]
"""Returns the response to a request, in any form that ``AsyncPublisher.publish`` takes; may be a coroutine function."""


class AsyncClient(UserPart[ViewClient]):
    """A service that a program calls; ``AsyncGraph.client`` makes it.

    Any number of calls may be under way; ``close`` fails them with ``GraphUnavailable``.
    """

    def __init__(self, view: View, inner: ViewClient, request: MessageType, response: MessageType, caller: str) -> None:
        super().__init__(view, inner, "service", inner.service)
        self.service = inner.service
        self._request, self._response = request, response
        self._caller = caller

    async def call(self, request: object = None, *, timeout_s: float = DEFAULT_TIMEOUT_S) -> TypedMessage:
        """Return the response to ``request``, given in any form that ``AsyncPublisher.publish`` takes.

        ``timeout_s`` bounds the wait for a provider and its response. Raises ``ValueMismatch`` if the request does not
        fit, ``NotServed``, ``CallTimeout``, ``ProviderLost``, or ``CallFailed`` with what the provider says.
        """
        raw = self._request.encode(request)
        left_s = await self._found(timeout_s)
        return self._response.message(await self._inner.call(Request(raw, caller=self._caller), left_s))


class AsyncService(OfferPart[ViewService]):
    """A service that a program offers; ``AsyncGraph.serve`` makes it.

    Calls run at the same time; ``close`` fails them with ``ProviderLost`` where the network can say so.
    """

    def __init__(self, view: View, request: MessageType, response: MessageType, handler: RequestHandler) -> None:
        super().__init__(view)
        self._handler = handler
        self._request, self._response = request, response

    async def answer(self, request: Request) -> bytes:
        """Answer a call; what the handler raises fails it."""
        response = self._handler(self._request.message(request.payload))
        if inspect.isawaitable(response):
            response = await response
        return self._response.encode(response)

    @property
    def service(self) -> str:
        """Return its name."""
        return self._server.service


def service_messages(registry: TypeRegistry, type: str) -> tuple[MessageType, MessageType]:
    """Return the types of requests and responses of a service. Raises ``UnknownType``."""
    return MessageType(registry, f"{type}_Request"), MessageType(registry, f"{type}_Response")
