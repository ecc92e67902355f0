"""Services called and served over a link. They outlive connections: each new one announces what is served."""

from __future__ import annotations

import asyncio
import logging
from collections import OrderedDict
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from ropeway import aio
from ropeway.errors import (
    CallFailed,
    CallTimeout,
    GraphUnavailable,
    LinkError,
    NotServed,
    ProviderLost,
    RopewayError,
    TypesError,
    WireError,
)
from ropeway.graph.base import Delivery
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Request, ServiceHandler
from ropeway.graph.local_calls import InFlight
from ropeway.logs import failed
from ropeway.networks.rosbridge.client.call_notes import call_note, failure, read_note, received
from ropeway.networks.rosbridge.client.calls import announced, answer_encoding, lane, travelling
from ropeway.networks.rosbridge.client.other_holder import OtherHolder
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY, ROSGW
from ropeway.tasks import Chores

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.client.calls import Calls
    from ropeway.networks.rosbridge.link.peer import Peer

__all__ = ["CALLS_LIMIT", "RemoteClient", "RemoteService"]

log = logging.getLogger("ropeway.rosbridge")

CALLS_LIMIT: Final = 4096
"""How many calls, or goals, one provider works at; more are refused."""

_REMEMBERED: Final = 1024  # calls that were answered, so that the same call does not run twice
_EARLIER_S: Final = 0.25
_REMEMBERED_BYTES: Final = 1 << 16  # longer answers are not kept


class RemoteClient:
    """A service that we call on the far graph."""

    def __init__(self, calls: Calls, service: str, type: str, delivery: Delivery) -> None:
        self.service = self.name = service
        self.type, self.delivery = type, delivery
        self.closed = False
        self._calls = calls
        self._under_way = InFlight()

    @property
    def available(self) -> bool | None:
        """Whether the far gateway shows a provider; false with the link down, ``None`` if the peer does not tell."""
        return False if self.closed else self._calls.available("service", self.service)

    @property
    def encoding(self) -> str:
        """The encoding of requests: a plain server has named none."""
        return travelling(self.delivery, self._calls.peer, None)

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``Client``."""
        return await self._calls.wait_available(self, timeout_s)

    async def call(self, request: Request, timeout_s: float = DEFAULT_TIMEOUT_S) -> bytes:
        """See ``Client``. With the link down it waits for it, then raises ``GraphUnavailable``."""
        if self.closed:
            raise GraphUnavailable(self._calls.graph.name, f"the client of {self.service} is closed")
        with self._under_way.call():
            return await self._call(request, timeout_s)

    async def _call(self, request: Request, timeout_s: float) -> bytes:
        began = asyncio.get_running_loop().time()
        deadline = began + timeout_s
        while True:
            peer = await self._calls.link(deadline)
            try:
                if peer.dialect is not ROSGW:
                    return await self._ask(peer, request, deadline, timeout_s)
                # It loses a call that comes during another, so each has its turn.
                async with aio.timeout_at(deadline), self._calls.turn(self.service):
                    return await self._ask(peer, request, deadline, timeout_s)
            except NotServed:
                if not await self._calls.may_try_again(self, began, deadline):
                    raise
            except TimeoutError:
                if self.available is False:
                    raise NotServed(self.service) from None
                raise CallTimeout(self.service, timeout_s) from None

    async def _ask(self, peer: Peer, request: Request, deadline: float, timeout_s: float) -> bytes:
        calls = self._calls
        loop = asyncio.get_running_loop()
        id = f"call_service:{self.service}:{calls.next()}"
        answer: asyncio.Future[ops.ServiceResponse] = loop.create_future()

        def unsent(error: Exception) -> None:
            if not answer.done():
                answer.set_exception(error)

        gateway = peer.dialect is ROPEWAY
        left_s = deadline - loop.time()
        if not gateway:
            left_s -= min(_EARLIER_S, left_s / 4)  # so that the server says first why there is no answer
        calls.pending[id] = answer
        try:
            peer.send_op(
                ops.CallService(
                    id=id,
                    service=self.service,
                    type=calls.graph.spelling.type_name(self.type),
                    args=None,
                    timeout=round(max(left_s, 0.001), 3),
                    ropeway=call_note(request, calls.graph.gateway_id, self.delivery.encoding) if gateway else None,
                ),
                payload=calls.written(f"{self.type}_Request", request.payload),
                field="args",
                codec=calls.codec(f"{self.type}_Request"),
                encoding=self.encoding,
                priority=lane(self.delivery),
                on_unsent=unsent,
            )
            expiry = loop.call_at(deadline, unsent, TimeoutError())
            try:
                response = await answer
            finally:
                expiry.cancel()
            if not response.result:
                raise received(self.service, response.values, response.ropeway, kind="service", timeout_s=timeout_s)
            return calls.read(f"{self.type}_Response", response.values, response.compression, peer)
        except GraphUnavailable:
            raise ProviderLost(self.service, f"the link to {calls.graph.name} was lost") from None
        except (TypesError, WireError, LinkError) as error:
            raise CallFailed(self.service, str(error)) from error
        finally:
            calls.pending.pop(id, None)

    async def close(self) -> None:
        """See ``Client``."""
        if not self.closed:
            self.closed = True
            self._calls.clients.pop(self, None)
            why = f"the client of {self.service} was closed in mid-call"
            await self._under_way.fail(GraphUnavailable(self._calls.graph.name, why))


class RemoteService:
    """A service that we serve on the far graph."""

    def __init__(self, calls: Calls, service: str, type: str, handler: ServiceHandler, delivery: Delivery) -> None:
        self.service = self.name = service
        self.type, self.delivery = type, delivery
        self.id = f"advertise_service:{service}:{calls.next()}"
        self.held = OtherHolder(calls.graph.name, "service", service)
        self.closed = False
        self._calls, self._handler = calls, handler
        self._peer: Peer | None = None
        self._asked: str | None = None  # the encoding that the last call asked for
        self._answering = Chores()
        self._known: OrderedDict[bytes, asyncio.Future[bytes]] = OrderedDict()

    @property
    def encoding(self) -> str:
        """The encoding of answers."""
        return travelling(self.delivery, self._peer, self._asked)

    @property
    def refused(self) -> str:
        """The reason why the far gateway does not let us serve it now, ``""`` if it does."""
        return self.held.by

    def on_state(self, callback: Callable[[str], None]) -> None:
        """Call with ``refused``, now and at each change."""
        self.held.on_state(callback)

    def connected(self, peer: Peer) -> None:
        """Announce the service on a new connection. Raises ``UnknownType`` if the peer needs the definition."""
        registry = self._calls.graph.registry
        gateway = peer.dialect is ROPEWAY
        if not gateway:
            registry.codec(f"{self.type}_Request")
            registry.codec(f"{self.type}_Response")
        self._peer = peer
        self.held.tell("")
        peer.send(
            ops.AdvertiseService(
                id=self.id,
                service=self.service,
                type=self._calls.graph.spelling.type_name(self.type),
                compression=announced(self.delivery, peer),
                ropeway=(self._calls.graph.type_note(self.type) or None) if gateway else None,
            )
        )

    def disconnected(self) -> None:
        """Drop the calls under way: the connection is gone, so nobody waits for the answers."""
        self._peer = None
        self._answering.cancel()

    def called(self, op: ops.CallService, peer: Peer) -> None:
        """Take a call."""
        self._asked = op.compression
        if len(self._answering) >= CALLS_LIMIT:
            self._fail(op, peer, CallFailed(self.service, f"{self.service} is busy with {CALLS_LIMIT} calls"))
            return
        self._answering.start(self._answer(op, peer), f"answer {self.service}")

    async def _answer(self, op: ops.CallService, peer: Peer) -> None:
        note = read_note(op.ropeway)
        try:
            payload = self._calls.read(f"{self.type}_Request", op.args, op.compression, peer)
            timeout_s = op.timeout if op.timeout is not None and op.timeout > 0 else None
            response = await self._once(Request(payload, note.id, note.via, note.caller, timeout_s))
            peer.send_op(
                ops.ServiceResponse(id=op.id, service=op.service, values=None, result=True),
                payload=self._calls.written(f"{self.type}_Response", response),
                field="values",
                codec=self._calls.codec(f"{self.type}_Response"),
                encoding=answer_encoding(self.delivery, peer, op),
                priority=lane(self.delivery),
                on_unsent=lambda error: self._fail(op, peer, error),
            )
        except RopewayError as error:
            self._fail(op, peer, error)
        except Exception as error:  # a handler is somebody else's code; its failure is the call's
            failed(log, "%s: the handler of %s failed", self._calls.graph.name, self.service)
            self._fail(op, peer, error)

    async def _once(self, request: Request) -> bytes:
        """Run the handler, or take the answer that the same call had before."""
        known = self._known
        before = known.get(request.id)
        if before is not None:
            await asyncio.wait({before})
            if before.cancelled():
                raise ProviderLost(self.service, "the call was given up")
            return before.result()
        answer = known[request.id] = asyncio.get_running_loop().create_future()
        answer.add_done_callback(_retrieved)
        while len(known) > _REMEMBERED and next(iter(known.values())).done():
            known.popitem(last=False)
        try:
            response = bytes(await self._handler(request))
        except asyncio.CancelledError:
            answer.cancel()
            raise
        except (NotServed, GraphUnavailable) as error:  # it was not carried out, and may be tried again
            del known[request.id]
            answer.set_exception(error)
            raise
        except Exception as error:
            answer.set_exception(error)
            raise
        answer.set_result(response)
        if len(response) > _REMEMBERED_BYTES:
            kept = known[request.id] = asyncio.get_running_loop().create_future()
            kept.set_exception(CallFailed(self.service, "this call was answered before"))
            kept.exception()
        return response

    def _fail(self, op: ops.CallService, peer: Peer, error: BaseException) -> None:
        word, text = failure(error)
        rosgw = peer.dialect is ROSGW  # it wants an object, even where there is none
        peer.send_op(
            ops.ServiceResponse(
                id=op.id,
                service=op.service,
                values={} if rosgw else text,
                result=False,
                ropeway={"error": word} if peer.dialect is ROPEWAY else None,
            )
        )

    async def close(self) -> None:
        """See ``Service``."""
        if self.closed:
            return
        self.closed = True
        self._calls.services.pop(self.service, None)
        peer, self._peer = self._peer, None
        if peer is not None:
            peer.send(ops.UnadvertiseService(id=self.id, service=self.service))
        await self._answering.close()


def _retrieved(future: asyncio.Future[bytes]) -> None:
    """Mark a failure as seen: it may concern the first caller only."""
    if not future.cancelled():
        future.exception()
