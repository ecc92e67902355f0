"""Services of several users of one graph: who serves a name serves it to the network and to all views."""

from __future__ import annotations

import asyncio
import logging
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import CallFailed, CallTimeout, GraphUnavailable, NotServed, ProviderLost
from ropeway.graph.base import Delivery, look_up
from ropeway.graph.calls import (
    DEFAULT_TIMEOUT_S,
    ActionClient,
    Client,
    Request,
    Service,
    ServiceHandler,
)
from ropeway.graph.local_calls import LEFT, InFlight, answer
from ropeway.hub.ownership import Claim, NameOwners
from ropeway.tasks import Chores, end

if TYPE_CHECKING:
    from ropeway.graph.base import Graph
    from ropeway.hub.actions import ViewActionServer

__all__ = ["NOBODY_S", "HubCalls", "ViewClient", "ViewService", "either"]

log = logging.getLogger("ropeway.hub")

NOBODY_S: Final = 1.0  # who calls a service that nobody serves learns it so soon, as from rosbridge
_LINGER_S: Final = 30.0  # a client of the graph is kept for the next call, which then need not wait for a match
_REMEMBERED: Final = 1024  # calls that were answered, so that the same call does not run twice
_REMEMBERED_BYTES: Final = 1 << 12  # longer answers are not kept
_CLIENTS: Final = 1024  # of the graph, used and lingering
_IDLE: Final = 64  # clients that linger; above, the one that does so for longest is closed


class _Shared:
    """A client of the graph that views share."""

    def __init__(self, inner: Client | ActionClient) -> None:
        self.inner = inner
        self.users = 0
        self.closing: asyncio.TimerHandle | None = None


class HubCalls:
    """Holds what the views of one hub share for services and actions."""

    def __init__(self, graph: Graph, gateway_id: str) -> None:
        self.graph, self.gateway_id = graph, gateway_id
        self.services: NameOwners[ViewService] = NameOwners(
            "service", graph.name, gateway_id, lambda name: look_up(graph, "service", name)
        )
        self.actions: NameOwners[ViewActionServer] = NameOwners(
            "action", graph.name, gateway_id, lambda name: look_up(graph, "action", name)
        )
        self._clients: dict[tuple[str, str, str], _Shared] = {}
        self._making: dict[tuple[str, str, str], asyncio.Future[None]] = {}
        self._idle: dict[tuple[str, str, str], None] = {}
        self._closers = Chores()
        self._calls: OrderedDict[bytes, asyncio.Future[bytes | Exception]] = OrderedDict()
        self.repeated = 0

    async def close(self) -> None:
        """Close the clients that linger."""
        for shared in self._clients.values():
            if shared.closing is not None:
                shared.closing.cancel()
        clients, self._clients = list(self._clients.values()), {}
        for shared in clients:
            await shared.inner.close()
        await self._closers.close()

    # ── clients of the graph ───────────────────────────────────────────────────────────────────────────────────

    async def acquire(self, kind: str, name: str, type: str, delivery: Delivery) -> Any:
        """Return the shared client of a service or an action. Raises ``CallFailed`` where there are too many."""
        key = (kind, name, type)
        while (making := self._making.get(key)) is not None:
            await asyncio.wait({making})
        shared = self._clients.get(key)
        if shared is None:
            shared = await self._make(key, delivery)
        shared.users += 1
        self._idle.pop(key, None)
        if shared.closing is not None:
            shared.closing.cancel()
            shared.closing = None
        return shared.inner

    async def _make(self, key: tuple[str, str, str], delivery: Delivery) -> _Shared:
        kind, name, type = key
        if len(self._clients) + len(self._making) >= _CLIENTS:
            raise CallFailed(name, f"{_CLIENTS} services and actions are in use already")
        made = self._making[key] = asyncio.get_running_loop().create_future()
        try:
            make = self.graph.create_client if kind == "service" else self.graph.create_action_client
            shared = self._clients[key] = _Shared(await make(name, type, delivery=delivery))
        finally:
            del self._making[key]
            made.set_result(None)
        return shared

    async def release(self, kind: str, name: str, type: str) -> None:
        """Release a view's use of a client, which lingers for the next user while there is a provider to call."""
        key = (kind, name, type)
        shared = self._clients.get(key)
        if shared is None:
            return
        shared.users -= 1
        if shared.users:
            return
        if shared.inner.available is False:
            if (closing := self._expire(key)) is not None:
                await asyncio.wait({closing})
            return
        self._idle[key] = None
        shared.closing = asyncio.get_running_loop().call_later(_LINGER_S, self._expire, key)
        if len(self._idle) > _IDLE:
            self._expire(next(iter(self._idle)))

    def _expire(self, key: tuple[str, str, str]) -> asyncio.Task[None] | None:
        self._idle.pop(key, None)
        shared = self._clients.pop(key, None)
        if shared is None:
            return None
        if shared.closing is not None:
            shared.closing.cancel()
        return self._closers.start(shared.inner.close(), f"close client {key[1]}")

    # ── calls ──────────────────────────────────────────────────────────────────────────────────────────────────

    def check_circle(self, name: str, via: tuple[str, ...]) -> None:
        """Refuse a call that has been here before."""
        if self.gateway_id and self.gateway_id in via:
            raise CallFailed(name, f"the call of {name} went in a circle, through the gateways {', '.join(via)}")

    def remember(self, request: Request) -> asyncio.Future[bytes | Exception]:
        """Remember a call that is under way, so that it is not made again."""
        calls = self._calls
        pending = calls[request.id] = asyncio.get_running_loop().create_future()
        while len(calls) > _REMEMBERED and next(iter(calls.values())).done():
            calls.popitem(last=False)
        return pending

    def settle(self, request: Request, pending: asyncio.Future[bytes | Exception], how: bytes | BaseException) -> None:
        """Record the end of a call. A call that was not carried out may be tried again; a long answer is not kept. What
        was not carried out may be tried again; a long answer is not kept.
        """
        if isinstance(how, (NotServed, GraphUnavailable)):
            self._calls.pop(request.id, None)
        elif isinstance(how, bytes) and len(how) > _REMEMBERED_BYTES:
            kept = self._calls[request.id] = asyncio.get_running_loop().create_future()
            kept.set_result(CallFailed("", "this call was answered before"))
        if isinstance(how, bytes):
            pending.set_result(how)
        elif isinstance(how, Exception):
            pending.set_result(_bare(how))
        else:
            pending.set_result(ProviderLost("", "the call was given up"))

    async def again(self, pending: asyncio.Future[bytes | Exception]) -> bytes:
        """Return the answer of a call that was made before."""
        self.repeated += 1
        await asyncio.wait({pending})
        how = pending.result()
        if isinstance(how, Exception):
            raise _bare(how)
        return how

    def known(self, request: Request) -> asyncio.Future[bytes | Exception] | None:
        """Return the earlier call with this id, if there is one."""
        return self._calls.get(request.id)


def _bare(error: Exception) -> Exception:
    """Return the same error without its traceback: a remembered error must not keep frames alive."""
    bare = type(error).__new__(type(error))
    bare.args = error.args
    bare.__dict__.update(error.__dict__)
    return bare


class ViewService:
    """A service that a view offers."""

    def __init__(
        self, calls: HubCalls, user: str, service: str, type: str, handler: ServiceHandler, delivery: Delivery
    ) -> None:
        self.service, self.type = service, type
        self._calls, self._handler, self._delivery = calls, handler, delivery
        self._running = InFlight()
        self.entry: Claim[ViewService] = Claim(service, user, self, self._create)
        self.on_closed: Callable[[], None] | None = None

    async def _create(self) -> Service:
        return await self._calls.graph.create_service(self.service, self.type, self._handle, delivery=self._delivery)

    async def _handle(self, request: Request) -> bytes:
        return await self._handler(request)

    @property
    def closed(self) -> bool:
        """Whether ``close`` was called."""
        return self.entry.closed

    @property
    def taken_by(self) -> str:
        """The other provider that holds the name, ``""`` while this one serves it."""
        return self.entry.taken_by

    def on_state(self, callback: Callable[[str], None]) -> None:
        """Call with ``taken_by``, now and at each change."""
        self.entry.on_state(callback)

    async def answer(self, request: Request, timeout_s: float) -> bytes:
        """Answer a call from inside this process."""
        return await answer(self.service, self._running, self._handle(request), timeout_s)

    async def close(self) -> None:
        """Serve no more; calls under way fail, and who waits for the name takes over."""
        if self.closed:
            return
        await self._calls.services.remove(self.entry)
        await self._running.fail(ProviderLost(self.service, LEFT))
        if self.on_closed is not None:
            self.on_closed()


class ViewClient:
    """A service that a view calls: at the view that serves it, or on the graph."""

    def __init__(self, calls: HubCalls, service: str, type: str) -> None:
        self.service, self.type = service, type
        self.closed = False
        self._calls = calls
        self._inner: Client | None = None
        self._under_way = InFlight()

    async def attach(self, delivery: Delivery) -> None:
        """Get the client of the graph."""
        self._inner = await self._calls.acquire("service", self.service, self.type, delivery)

    def _provider(self) -> ViewService | None:
        entry = self._calls.services.holder(self.service)
        return entry.provider if entry is not None else None

    @property
    def available(self) -> bool | None:
        """Whether a view or a provider on the network serves it."""
        if self._provider() is not None:
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

    async def call(self, request: Request, timeout_s: float = DEFAULT_TIMEOUT_S) -> bytes:
        """See ``Client``."""
        if self.closed:
            raise GraphUnavailable(self._calls.graph.name, f"the client of {self.service} is closed")
        self._calls.check_circle(self.service, request.via)
        calls = self._calls
        known = calls.known(request)
        if known is not None:
            return await calls.again(known)
        pending = calls.remember(request)
        try:
            with self._under_way.call():
                response = await self._call(request, timeout_s)
        except BaseException as error:
            calls.settle(request, pending, error)
            raise
        calls.settle(request, pending, response)
        return response

    async def _call(self, request: Request, timeout_s: float) -> bytes:
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
        """Call no more."""
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
