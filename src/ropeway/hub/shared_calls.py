"""Holds what the users of one graph share for services and actions: clients of the graph, and calls that run once."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from typing import Any, Final

from ropeway.errors import CallFailed, GraphUnavailable, NotServed, ProviderLost
from ropeway.graph.base import Delivery, Graph, look_up
from ropeway.graph.calls import (
    ActionClient,
    Client,
    Request,
)
from ropeway.hub.actions import ViewActionServer
from ropeway.hub.calls import PendingCall, ViewService
from ropeway.hub.ownership import NameOwners
from ropeway.tasks import Chores, settled

__all__ = ["HubCalls"]

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
        self._calls: OrderedDict[bytes, PendingCall] = OrderedDict()
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
            await settled(making)
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
                await settled(closing)
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

    def begin(self, name: str, request: Request) -> PendingCall | None:
        """Remember a call that is under way; return ``None`` where the same was made before: it is not made again.

        This is the one place where that is found out, whatever ways a call came. Raises ``CallFailed`` for a call that
        went in a circle.
        """
        if self.gateway_id in request.via:
            self.check_circle(name, request.via)
        calls = self._calls
        if request.id in calls:
            return None
        pending = calls[request.id] = asyncio.get_running_loop().create_future()
        while len(calls) > _REMEMBERED and next(iter(calls.values())).done():
            calls.popitem(last=False)
        return pending

    def is_new(self, request: Request) -> bool:
        """Return whether a call was not made before, by whatever way, and did not go in a circle."""
        return request.id not in self._calls and self.gateway_id not in request.via

    def withdraw(self, request: Request) -> None:
        """Forget a call that was not made after all."""
        del self._calls[request.id]

    def settle(self, request: Request, pending: PendingCall, how: bytes | BaseException) -> None:
        """Record the end of a call. One that was not carried out may be tried again; a long answer is not kept."""
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

    async def again(self, request: Request) -> bytes:
        """Return the answer of a call that was made before."""
        self.repeated += 1
        pending = self._calls[request.id]
        await settled(pending)
        how = pending.result()
        if isinstance(how, Exception):
            raise _bare(how)
        return how


def _bare(error: Exception) -> Exception:
    """Return the same error without its traceback: a remembered error must not keep frames alive."""
    bare = type(error).__new__(type(error))
    bare.args = error.args
    bare.__dict__.update(error.__dict__)
    return bare
