"""A service of others that we call: each request is a query of Zenoh's."""

from __future__ import annotations

import asyncio
import time
from functools import partial
from typing import Any, Final

import zenoh

from ropeway import aio
from ropeway.errors import CallError, CallFailed, CallTimeout, NotServed, ProviderLost, TypesError
from ropeway.graph.base import Undelivered
from ropeway.graph.calls import Request
from ropeway.graph.inlet import Inlet
from ropeway.graph.parts import ClientBase
from ropeway.limits import SHOWN_TEXT_CHARACTERS, ZENOH_REQUESTS_BYTES
from ropeway.networks.dds.in_flight import InFlightRequests
from ropeway.networks.zenoh.attachment import pack
from ropeway.networks.zenoh.calls import REQUEST, RESPONSE, SERVICE_QOS, ZenohCallHost
from ropeway.networks.zenoh.sender import ZenohLane
from ropeway.networks.zenoh.session import ZenohPresence
from ropeway.networks.zenoh.tokens import ZenohToken

__all__ = ["ZenohClient"]

_CALLS_LIMIT: Final = 16_384
_NOBODY_S: Final = 1.0  # a server that comes just now is waited for so long
_LATER_S: Final = 1.0  # Zenoh gives a query up so much later than we do
_GRACE_S: Final = 0.2  # an answer that is on its way when its server leaves may arrive so much later
_DEFERRED: Final = "/_action/get_result"
_SHORTEST_BYTES: Final = 4
_LOST: Final = "its server has left, or gave no answer"


class _Call:
    """A call under way, and how it ended."""

    __slots__ = ("cancel", "outcome")

    def __init__(self) -> None:
        self.cancel = zenoh.CancellationToken()
        self.outcome: asyncio.Future[bytes | CallError] = asyncio.get_running_loop().create_future()

    def finish(self, outcome: bytes | CallError) -> bool:
        """End the call, unless it has ended; return whether it had not."""
        if self.outcome.done():
            return False
        self.outcome.set_result(outcome)
        return True


class ZenohClient(ClientBase[ZenohCallHost]):
    """Calls ``service``: any number of calls at a time, each at the server that Zenoh takes for the nearest."""

    def __init__(self, graph: ZenohCallHost, service: str, type: str, type_hash: str) -> None:
        super().__init__(graph, service, type)
        self._session = graph.session
        self._loop = asyncio.get_running_loop()
        self._number = 0
        self._calls: dict[_Call, None] = {}
        self._window = InFlightRequests(deferred=service.endswith(_DEFERRED))
        self._lane = ZenohLane(self._unsent)
        self._losing: asyncio.TimerHandle | None = None
        self._inlet: Inlet[tuple[_Call, bytes | CallError]] = Inlet(
            self._loop, self._on_answers, limit_bytes=ZENOH_REQUESTS_BYTES
        )
        self._presence = ZenohPresence(graph.session, "client", service, type, type_hash, SERVICE_QOS)

    @property
    def available(self) -> bool:
        """Whether somebody else serves it now."""
        return not self.closed and bool(self._servers())

    def follow(self) -> None:
        """See who serves it."""
        servers = self._servers()
        self._presence.follow(token.type_hash for token in servers)
        if servers:
            self._window.resize(min(token.qos.depth for token in servers))
        elif self._calls and self._losing is None:
            self._losing = self._loop.call_later(_GRACE_S, self._lose)
        self.changed.notify()

    async def _call(self, request: Request, timeout_s: float) -> bytes:
        if len(self._calls) >= _CALLS_LIMIT:
            raise CallFailed(self.service, f"{_CALLS_LIMIT} calls of {self.service} are under way, which is the limit")
        until = self._loop.time() + timeout_s
        call = _Call()
        self._calls[call] = None
        try:
            if not await self.wait_available(min(timeout_s, _NOBODY_S)):
                self._check_open()
                raise NotServed(self.service)
            async with aio.timeout_at(until):
                ticket = await self._window.enter()
                try:
                    type_hash = self._ask(call, request, until - self._loop.time())
                    outcome = await call.outcome
                finally:
                    self._window.leave(ticket, answered=call.outcome.done() and not call.outcome.cancelled())
        except TimeoutError:
            raise CallTimeout(self.service, timeout_s) from None
        finally:
            del self._calls[call]
            if not call.outcome.done() or call.outcome.cancelled():
                call.cancel.cancel()
        if not isinstance(outcome, bytes):
            raise outcome
        try:
            return self._graph.layouts.read(self.type, outcome, type_hash, part=RESPONSE)
        except TypesError as error:
            self._graph.drops[self.service, Undelivered.DECODE] += 1
            raise CallFailed(self.service, f"the answer cannot be read: {error}") from error

    def _ask(self, call: _Call, request: Request, left_s: float) -> str:
        """Send a request, and return the hash of its type at the server."""
        servers = self._servers()
        if not servers:
            raise NotServed(self.service)
        type_hash = servers[0].type_hash
        try:
            payload = self._graph.layouts.write(self.type, request.payload, type_hash, part=REQUEST)
        except TypesError as error:
            raise CallFailed(self.service, f"the server's layout cannot hold the request: {error}") from error
        self._number += 1
        handler: Any = zenoh.handlers.Callback(
            partial(self._on_reply, call), drop=partial(self._on_end, call), indirect=False
        )
        gid = self._presence.gid(type_hash if type_hash in self._presence.hashes else self._presence.type_hash)
        put = partial(
            self._session.raw.get,
            self._session.key(self.service, self.type, type_hash),
            handler,
            target=zenoh.QueryTarget.BEST_MATCHING,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=max(left_s, 0.0) + _LATER_S,
            payload=payload,
            attachment=pack(self._number, time.time_ns(), gid),
            allowed_destination=zenoh.Locality.REMOTE,
            cancellation_token=call.cancel,
        )
        self._graph.sender.send(self._lane, put, len(payload))
        return type_hash

    def _servers(self) -> list[ZenohToken]:
        return self._graph.discovery.others("server", self.service, self.type)

    # In a thread of Zenoh's -------------------------------------------------------------------------------------

    def _on_reply(self, call: _Call, reply: zenoh.Reply) -> None:
        if (answer := reply.ok) is not None:
            payload = bytes(answer.payload)
            if len(payload) < _SHORTEST_BYTES:
                self._inlet.put((call, CallFailed(self.service, f"an answer of {len(payload)} bytes is not CDR")))
            else:
                self._inlet.put((call, payload), len(payload))
        elif (error := reply.err) is not None:
            text = bytes(error.payload)[: 4 * SHOWN_TEXT_CHARACTERS].decode(errors="replace")
            self._inlet.put((call, CallFailed(self.service, text[:SHOWN_TEXT_CHARACTERS])))

    def _on_end(self, call: _Call) -> None:
        self._inlet.put((call, ProviderLost(self.service, _LOST)))

    # On the loop ------------------------------------------------------------------------------------------------

    def _on_answers(self, batch: list[tuple[_Call, bytes | CallError]]) -> None:
        for call, outcome in batch:
            if not call.finish(outcome) and isinstance(outcome, bytes):
                self._graph.drops[self.service, Undelivered.LATE] += 1

    def _unsent(self, count: int) -> None:
        self._graph.drops[self.service, Undelivered.WRITE] += count

    def _lose(self) -> None:
        self._losing = None
        if not self._servers():
            for call in self._calls:
                call.finish(ProviderLost(self.service, _LOST))

    async def _leave(self) -> None:
        self._inlet.closed = True
        self._window.close()
        if self._losing is not None:
            self._losing.cancel()
        self._presence.close()
        self._graph.forget(self)
