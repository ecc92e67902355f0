"""A service of others that we call over DDS, in the mapping of rmw_cyclonedds."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

from ropeway import aio
from ropeway.errors import (
    CallFailed,
    CallTimeout,
    GraphUnavailable,
    NotServed,
    ProviderLost,
    TypesError,
    ValueMismatch,
)
from ropeway.graph.base import Sample, Undelivered
from ropeway.graph.begun import Begun, Ended
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Client, Request
from ropeway.logs import failed
from ropeway.networks.dds.in_flight import InFlightRequests
from ropeway.networks.dds.matching import paired
from ropeway.networks.dds.records import MatchedEndpoint
from ropeway.networks.dds.rpc import HEADER_BYTES, MAX_SEQ, RequestHeader, join, split
from ropeway.networks.dds.service_endpoints import LITTLE_ENDIAN, DdsCallHost, Ends
from ropeway.networks.dds.vendors import HEADER_VENDOR, speaks_header, vendor_name
from ropeway.tasks import background, end

__all__ = ["DdsClient"]

log = logging.getLogger("ropeway.dds")

# We match a server a little before it matches us, and what it gets before that is lost.
_SETTLE_S: Final = 0.2
# Ropeway's own services run a request once however often it comes, so that the first ones need not wait …
_AGAIN_S: Final = (0.05, 0.2, 0.5, 1.0)
# … but come again while the match is so fresh.
_FRESH_S: Final = 2.0
_NOBODY_S: Final = 1.0
_RETRY_S: Final = 0.005  # after a write that the network has no room for
_CALLS_LIMIT: Final = 16_384
_DEFERRED: Final = "/_action/get_result"
_new: Final = tuple.__new__  # of named tuples, without a call of Python


class _Call(Begun):
    """A call under way, and who may answer it."""

    __slots__ = ("servers",)

    servers: frozenset[bytes]


class DdsClient(Ends):
    """Calls ``service``: any number of calls at a time on one pair of endpoints.

    A request goes out when a server is matched in both directions and has had time to match us. Servers of another
    mapping are called through the graph's ``helper``, where it has one.
    """

    def __init__(self, graph: DdsCallHost, service: str, type: str) -> None:
        super().__init__(graph, service, type)
        self._request_type, self._response_type = f"{self.type}_Request", f"{self.type}_Response"
        self.late = 0  # answers that nobody waited for any more, or that another server gave, too
        self._seq = 0
        self._calls: dict[int, _Call] = {}
        self._waiting = 0
        self._window = InFlightRequests(deferred=self.service.endswith(_DEFERRED))
        self._servers: dict[bytes, float] = {}  # ours to call, and when each was matched
        self._who_serves: frozenset[bytes] = frozenset()
        self._all_ours = False
        self._ready_at = math.inf  # when a request may go to them
        self._fresh_until = 0.0
        self._others: tuple[MatchedEndpoint, ...] = ()
        self._lost: set[bytes] = set()
        self._losing: asyncio.Task[None] | None = None
        self._helped: Client | None = None
        self._helping = asyncio.Lock()

    # Calling ----------------------------------------------------------------------------------------------------

    @property
    def available(self) -> bool:
        """Whether a provider that we can call serves it now."""
        return not self.closed and bool(self._servers or (self._others and self._graph.helper is not None))

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``Client``."""
        until = self._loop.time() + timeout_s
        while not self.available and not self.closed and self._loop.time() < until:
            await self._change(until)
        return self.available

    def begin(self, request: Request, timeout_s: float, ended: Ended) -> Begun | None:
        """See ``BeginningClient``: with servers that were matched a while ago, and room at them."""
        loop, window = self._loop, self._window
        now = loop.time()
        if self.closed or now < self._ready_at or now < self._fresh_until or self._waiting >= _CALLS_LIMIT:
            return None
        try:
            payload = self._graph.layouts.write("server", self.service, self._request_type, request.payload)
        except ValueMismatch:
            return None  # ``call`` says so
        if not self._writer.sends_at_once(len(payload) + HEADER_BYTES) or not (ticket := window.try_enter()):
            return None
        seq = self._seq = self._seq % MAX_SEQ + 1
        if self._writer.send_at_once(join(_new(RequestHeader, (self._id, seq)), payload)) is not None:
            window.leave(ticket, answered=False)
            return None

        def over(how: bytes | BaseException) -> None:
            del self._calls[seq]
            self._waiting -= 1
            window.leave(ticket, answered=not isinstance(how, (TimeoutError, asyncio.CancelledError)))
            if isinstance(how, bytes):
                try:
                    how = self._graph.layouts.read("server", self.service, self._response_type, how)
                except TypesError as error:
                    how = self._unfit(error)
            elif isinstance(how, TimeoutError):
                how = CallTimeout(self.service, timeout_s)
            ended(how)

        self._waiting += 1
        call = self._calls[seq] = _Call(over)
        call.servers = self._who_serves
        call.expiry = loop.call_at(now + timeout_s, call.expire)
        return call

    async def call(self, request: Request, timeout_s: float = DEFAULT_TIMEOUT_S) -> bytes:
        """See ``Client``. ``CallFailed`` also where only servers of another mapping are there and nobody helps."""
        if self.closed:
            raise self._is_closed()
        if self._waiting >= _CALLS_LIMIT:
            raise CallFailed(self.service, f"{self._waiting} calls of {self.service} are under way, which is the limit")
        self._waiting += 1
        layouts = self._graph.layouts
        try:
            payload = layouts.write("server", self.service, self._request_type, request.payload)
            now = self._loop.time()
            until = now + timeout_s
            if now < self._ready_at or not (ticket := self._window.try_enter()):
                ticket = await self._turn(until)
            if ticket:
                response = await self._ask(payload, until, ticket)
            else:
                response = await self._call_other(replace(request, payload=payload), until)
            return layouts.read("server", self.service, self._response_type, response)
        except ValueMismatch as error:
            raise self._unfit(error) from error
        except TimeoutError:
            raise CallTimeout(self.service, timeout_s) from None
        finally:
            self._waiting -= 1

    def _unfit(self, error: TypesError) -> CallFailed:
        return CallFailed(self.service, f"the server's layout cannot hold the request: {error}")

    async def _turn(self, until: float) -> int:
        """Wait for a server and for room at it; return the ticket, 0 where only those of another mapping serve."""
        while await self._served(until):
            async with aio.timeout_at(until):
                ticket = await self._window.enter()
            if self._servers:
                return ticket
            self._window.leave(ticket, answered=False)
        return 0

    async def _ask(self, payload: bytes, until: float, ticket: int) -> bytes:
        seq = self._seq = self._seq % MAX_SEQ + 1
        outcome: asyncio.Future[bytes | BaseException] = self._loop.create_future()
        call = self._calls[seq] = _Call(partial(_resolve, outcome))
        call.servers = self._who_serves
        answered = False
        try:
            if self.closed:
                raise self._is_closed()
            message = join(_new(RequestHeader, (self._id, seq)), payload)
            if (reason := await self._writer.send(message)) is not None:
                await self._send_again(message, reason, until)
            if self._loop.time() < self._fresh_until:
                await self._repeat(message, outcome, until)
            if not outcome.done():
                call.expiry = self._loop.call_at(until, call.expire)
            how = await outcome
            answered = not isinstance(how, TimeoutError)
        finally:
            if call.expiry is not None:
                call.expiry.cancel()
            del self._calls[seq]
            self._window.leave(ticket, answered=answered)
        if isinstance(how, bytes):
            return how
        raise how

    async def _repeat(self, message: bytes, outcome: asyncio.Future[Any], until: float) -> None:
        """Send a request again until it is answered: a server that was matched just now may have missed it."""
        for pause in _AGAIN_S:
            await asyncio.wait((outcome,), timeout=max(0.0, min(until - self._loop.time(), pause)))
            if outcome.done() or not self._all_ours:
                return
            if (reason := await self._writer.send(message)) is not None:
                await self._send_again(message, reason, until)

    async def _served(self, until: float) -> bool:
        """Wait for a server; false where there are only servers of another mapping."""
        nobody = min(until, self._loop.time() + _NOBODY_S)
        while True:
            self._check_open()
            now = self._loop.time()
            if self._servers:
                if self._ready_at <= now:
                    return True
                if now >= until:
                    raise TimeoutError
                await self._change(min(self._ready_at, until))
            elif self._others and (self._graph.helper is not None or now >= nobody):
                return False
            elif now >= nobody:
                raise NotServed(self.service)
            else:
                await self._change(nobody)

    async def _call_other(self, request: Request, until: float) -> bytes:
        helper = self._graph.helper
        if helper is None:
            who = self._others[0].guid if self._others else b""
            raise CallFailed(
                self.service,
                f"{self.service} is served over {vendor_name(who)} only, whose requests this graph cannot make; "
                "run the server with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or use the ros2 graph",
            )
        async with aio.timeout_at(until), self._helping:
            self._check_open()
            if self._helped is None:
                self._helped = await helper.create_client(self.service, self.type)
        return await self._helped.call(request, max(0.0, until - self._loop.time()))

    async def _send_again(self, message: bytes, reason: Undelivered | None, until: float) -> None:
        """Send a request that was not sent for some ``reason``, once that is possible."""
        while reason is not None:
            if reason is Undelivered.CLOSED:
                self._check_open()
            if reason is not Undelivered.WRITE:
                self._graph.drops[self.service, reason] += 1
                raise CallFailed(self.service, f"the request of {len(message)} bytes cannot be sent: {reason.value}")
            if self._loop.time() >= until:
                self._graph.drops[self.service, reason] += 1
                raise TimeoutError
            await asyncio.sleep(_RETRY_S)
            reason = await self._writer.send(message)

    def _is_closed(self) -> GraphUnavailable:
        return GraphUnavailable(self._graph.name, f"the client of {self.service} is closed")

    def _check_open(self) -> None:
        if self.closed:
            raise self._is_closed()

    async def _change(self, until: float) -> None:
        """Wait for a change of the servers, at most until then."""
        with contextlib.suppress(TimeoutError):
            async with aio.timeout_at(until):
                await self._changed.wait()

    # From DDS ---------------------------------------------------------------------------------------------------

    def on_samples(self, batch: Sequence[Sample]) -> None:
        """Take the answers of servers, on the loop: to our requests and to those of every other client."""
        for sample in batch:
            if not sample.origin.startswith(HEADER_VENDOR):
                continue
            reply = split(sample.payload)
            if reply is None:
                self._graph.drops[self.service, Undelivered.DECODE] += 1
                continue
            if reply.header.client != self._id:
                continue
            call = self._calls.get(reply.header.seq)
            if call is None or call.over:
                self.late += 1
                log.debug("%s: %s: answer %d came late", self._graph.name, self.service, reply.header.seq)
                continue
            try:
                payload = reply.payload
                if payload[1] != LITTLE_ENDIAN:
                    payload = self._graph.little_endian(self._response_type, payload)
            except TypesError as error:
                self._graph.drops[self.service, Undelivered.DECODE] += 1
                call.end(CallFailed(self.service, f"the answer cannot be read: {error}"))
            else:
                call.end(payload)

    def on_match(self) -> None:
        """Take the current list of matched servers."""
        found = paired(
            (reader for reader in self._readers if not reader.helper),
            (writer for writer in self._writers if not writer.helper),
        )
        now = self._loop.time()
        mine = {guid: peer for guid, peer in found.items() if speaks_header(guid)}
        self._lost |= self._servers.keys() - mine.keys()
        self._servers = {guid: self._servers.get(guid, now) for guid in mine}
        self._who_serves = frozenset(mine)
        self._all_ours = all(peer.ours for peer in mine.values())
        matched = self._servers.values()
        self._ready_at = min(matched, default=math.inf) + (0.0 if self._all_ours else _SETTLE_S)
        self._fresh_until = max(matched, default=0.0) + _FRESH_S if self._all_ours else 0.0
        self._others = tuple(peer for guid, peer in found.items() if guid not in mine)
        if self._others and not mine and self._graph.helper is not None:
            self._graph.helper.wake()
        if mine:
            self._window.resize(min(peer.depth for peer in mine.values()))
        if self._lost and self._losing is None:
            self._losing = background(self._lose(), f"lost servers of {self.service}")

    async def _lose(self) -> None:
        """Fail the calls that nobody is left to answer, after what has arrived."""
        while self._lost:
            lost, self._lost = self._lost, set()
            try:
                await self._graph.participant.pump.call(self._reader.on_data)
            except GraphUnavailable:
                pass
            except Exception:  # what had arrived cannot be read; the calls fail all the same
                failed(log, "%s: reading answers of %s failed", self._graph.name, self.service)
            for call in list(self._calls.values()):
                call.servers -= lost
                if not call.servers:
                    call.end(ProviderLost(self.service, "its server has left"))
        self._losing = None

    async def close(self) -> None:
        """See ``Client``."""
        if self.closed:
            return
        self.closed = True
        self._changed.notify()
        for call in list(self._calls.values()):
            call.end(GraphUnavailable(self._graph.name, f"the client of {self.service} was closed in mid-call"))
        self._window.close()
        await end(self._losing)
        async with self._helping:
            if self._helped is not None:
                await self._helped.close()
        await self._graph.remove(self)


def _resolve(outcome: asyncio.Future[bytes | BaseException], how: bytes | BaseException) -> None:
    if not outcome.done():
        outcome.set_result(how)
