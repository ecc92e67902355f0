"""Shares the services of one graph between its users: a provider serves the network and all views."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any, Final, Protocol

from ropeway.errors import CallFailed, CallTimeout, GraphUnavailable, NotServed, ProviderLost
from ropeway.graph.base import Delivery, Graph, look_up
from ropeway.graph.begun import BeginningClient, Begins, Begun, Ended
from ropeway.graph.calls import (
    DEFAULT_TIMEOUT_S,
    Client,
    Request,
    Service,
    ServiceHandler,
)
from ropeway.graph.local_calls import LEFT, InFlight, answer
from ropeway.hub.ownership import Claim, Claimant, NameOwners
from ropeway.tasks import end

__all__ = ["NOBODY_S", "PendingCall", "SharedClients", "SharedServices", "ViewClient", "ViewService", "either"]

log = logging.getLogger("ropeway.hub")

NOBODY_S: Final = 1.0  # who calls a service that nobody serves learns it so soon, as from rosbridge


PendingCall = asyncio.Future[bytes | Exception]
"""A call that is under way, and what came of it."""


class SharedClients(Protocol):
    """Holds the clients that the users of one graph share; ``HubCalls`` is one."""

    graph: Graph

    async def acquire(self, kind: str, name: str, type: str, delivery: Delivery) -> Any:
        """Return the shared client of a name. Raises ``CallFailed`` where there are too many."""
        ...

    async def release(self, kind: str, name: str, type: str) -> None:
        """Let go of the shared client."""
        ...

    def check_circle(self, name: str, via: tuple[str, ...]) -> None:
        """Raise ``CallFailed`` for a call or a goal that has been here before."""
        ...


class SharedServices(SharedClients, Protocol):
    """Holds what the users of one graph share of its services."""

    services: NameOwners[ViewService]

    def begin(self, name: str, request: Request) -> PendingCall | None:
        """Note that a call is under way; return ``None`` where the same was made before.

        Raises ``CallFailed`` for one that went in a circle.
        """
        ...

    def is_new(self, request: Request) -> bool:
        """Return whether ``begin`` would take the call."""
        ...

    def withdraw(self, request: Request) -> None:
        """Forget a call that was not made after all."""
        ...

    def settle(self, request: Request, pending: PendingCall, how: bytes | BaseException) -> None:
        """Note how a call has ended."""
        ...

    async def again(self, request: Request) -> bytes:
        """Return the answer of a call that was made before."""
        ...


class ViewService(Claimant):
    """A service that a view offers."""

    def __init__(
        self, calls: SharedServices, user: str, service: str, type: str, handler: ServiceHandler, delivery: Delivery
    ) -> None:
        self.service, self.type = service, type
        self._calls, self._handler, self._delivery = calls, handler, delivery
        self._running = InFlight()
        super().__init__(Claim(service, user, self, self._create))

    async def _create(self) -> Service:
        return await self._calls.graph.create_service(self.service, self.type, self._handler, delivery=self._delivery)

    async def answer(self, request: Request, timeout_s: float) -> bytes:
        """Answer a call from inside this process."""
        return await answer(self.service, self._running, self._handler(request), timeout_s)

    async def close(self) -> None:
        """Stop serving; calls under way fail, and the next claim to the name takes over."""
        if self.closed:
            return
        await self._calls.services.remove(self.entry)
        await self._running.fail(ProviderLost(self.service, LEFT))
        self._tell_closed()


class ViewClient:
    """A service that a view calls: at the view that serves it, or on the graph."""

    def __init__(self, calls: SharedServices, service: str, type: str) -> None:
        self.service, self.type = service, type
        self.closed = False
        self._calls = calls
        self._inner: Client | None = None
        self._begins: Begins | None = None
        self._under_way = InFlight()

    async def attach(self, delivery: Delivery) -> None:
        """Get the client of the graph."""
        inner = self._inner = await self._calls.acquire("service", self.service, self.type, delivery)
        self._begins = inner.begin if isinstance(inner, BeginningClient) else None

    def _provider(self) -> ViewService | None:
        entry = self._calls.services.holder(self.service)
        return entry.provider if entry is not None else None

    @property
    def available(self) -> bool | None:
        """Whether a view or a provider on the network serves it."""
        if self._calls.services.holder(self.service) is not None:
            return True
        return self._inner.available if self._inner is not None else False

    @property
    def listed(self) -> bool:
        """Whether the graph knows a server, reached or not."""
        info = look_up(self._calls.graph, "service", self.service)
        return info is not None and bool(info.servers)

    @property
    def busy(self) -> bool:
        """Whether a call is under way."""
        return self._under_way.busy

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``Client``."""
        assert self._inner is not None
        return await either(
            self._inner.wait_available(timeout_s), lambda: self._provider() is not None, self._calls.services, timeout_s
        )

    async def find(self, timeout_s: float) -> None:
        """Wait a moment for who serves it. Raises ``NotServed``, or ``CallTimeout`` where that was too short."""
        if (
            self._inner is not None
            and self.available is False
            and not await self.wait_available(min(NOBODY_S, timeout_s))
        ):
            if timeout_s < NOBODY_S and self.listed:  # the caller's time was too short for a server that came just now
                raise CallTimeout(self.service, timeout_s)
            raise NotServed(self.service)

    def begin(self, request: Request, timeout_s: float, ended: Ended) -> Begun | None:
        """See ``BeginningClient``: where the graph serves it, and no view."""
        calls, begins, begun = self._calls, self._begins, self._under_way.begun
        if (
            self.closed
            or begins is None
            or calls.services.holder(self.service) is not None
            or not calls.is_new(request)
        ):
            return None
        pending = calls.begin(self.service, request)
        assert pending is not None

        def over(how: bytes | BaseException) -> None:
            begun.discard(call)
            calls.settle(request, pending, how)
            ended(how)

        made = begins(request, timeout_s, over)
        if made is None:
            calls.withdraw(request)
            return None
        call = made
        begun.add(call)
        return call

    async def call(self, request: Request, timeout_s: float = DEFAULT_TIMEOUT_S) -> bytes:
        """See ``Client``."""
        if self.closed:
            raise GraphUnavailable(self._calls.graph.name, f"the client of {self.service} is closed")
        calls = self._calls
        pending = calls.begin(self.service, request)
        if pending is None:
            return await calls.again(request)
        try:
            with self._under_way.call():
                inner = self._inner
                if calls.services.holder(self.service) is None and inner is not None and inner.available is not False:
                    response = await inner.call(request, timeout_s)
                else:
                    response = await self._find_and_call(request, timeout_s)
        except BaseException as error:
            calls.settle(request, pending, error)
            raise
        calls.settle(request, pending, response)
        return response

    async def _find_and_call(self, request: Request, timeout_s: float) -> bytes:
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        await self.find(timeout_s)
        left = max(deadline - loop.time(), 0.001)
        provider = self._provider()
        if provider is not None:
            if provider.type != self.type:
                raise CallFailed(self.service, f"{self.service} is of type {provider.type}, not {self.type}")
            request.timeout_s = request.timeout_s or timeout_s
            return await provider.answer(request, left)
        if self._inner is None:
            raise NotServed(self.service)
        return await self._inner.call(request, left)

    async def close(self) -> None:
        """Stop calling."""
        if self.closed:
            return
        self.closed = True
        why = f"the client of {self.service} was closed in mid-call"
        await self._under_way.fail(GraphUnavailable(self._calls.graph.name, why))
        if self._inner is not None:
            self._inner = None
            await self._calls.release("service", self.service, self.type)


async def either(inner: Awaitable[bool], here: Callable[[], bool], holders: NameOwners[Any], timeout_s: float) -> bool:
    """Wait until a view serves the name or the graph knows a provider, and return whether one does."""
    network = asyncio.ensure_future(inner)
    deadline = asyncio.get_running_loop().time() + timeout_s
    try:
        while True:
            if here():
                return True
            left = deadline - asyncio.get_running_loop().time()
            waited: set[asyncio.Future[Any]] = {network, holders.changed()}
            await asyncio.wait(waited, timeout=max(left, 0), return_when=asyncio.FIRST_COMPLETED)
            if here():
                return True
            if network.done():
                return bool(network.result())
            if left <= 0:
                return False
    finally:
        await end(network)
