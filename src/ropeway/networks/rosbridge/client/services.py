"""Services called and served over a link. They outlive connections: each new one announces what is served."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

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
from ropeway.graph.begun import BeginningHandler, Begun, Ended, into
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Request, ServiceHandler
from ropeway.graph.parts import ClientBase
from ropeway.logs import failed
from ropeway.networks.rosbridge.client.call_notes import call_note, failure, read_note, received
from ropeway.networks.rosbridge.client.calls import answer_encoding, lane, travelling
from ropeway.networks.rosbridge.client.host import LinkGraph
from ropeway.networks.rosbridge.client.provider import LinkProvider
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

_EARLIER_S: Final = 0.25


class RemoteClient(ClientBase[LinkGraph]):
    """A service that we call on the far graph."""

    def __init__(self, calls: Calls, service: str, type: str, delivery: Delivery) -> None:
        super().__init__(calls.graph, service, type)
        self.name, self.delivery = service, delivery
        self._calls = calls
        self._lane = lane(delivery)
        self._again = Chores()

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
            self._check_open()
        clock = asyncio.get_running_loop().time
        began = clock()
        deadline = began + timeout_s
        calls = self._calls
        with self._under_way.call():
            while True:
                peer = calls.peer or await calls.link(deadline)
                try:
                    if peer.dialect is not ROSGW:
                        return await self._ask(peer, request, deadline, timeout_s)
                    # It loses a call that comes during another, so each has its turn.
                    async with aio.timeout_at(deadline), calls.turn(self.service):
                        return await self._ask(peer, request, deadline, timeout_s)
                except NotServed:
                    if not await calls.may_try_again(self, began, deadline):
                        raise
                except TimeoutError:
                    if self.available is False:
                        raise NotServed(self.service) from None
                    raise CallTimeout(self.service, timeout_s) from None

    def begin(self, request: Request, timeout_s: float, ended: Ended) -> Begun | None:
        """See ``BeginningClient``: where the peer is a gateway and the link is up."""
        calls, under_way = self._calls, self._under_way.begun
        peer = calls.peer
        if self.closed or peer is None or peer.dialect is not ROPEWAY:
            return None
        gateway = peer
        loop = asyncio.get_running_loop()
        began = loop.time()

        def answered(how: ops.ServiceResponse | BaseException) -> None:
            try:
                if isinstance(how, BaseException):
                    raise how
                call.end(self._read(gateway, how, timeout_s))
            except NotServed:
                self._again.start(self._try_again(request, call, began, timeout_s), f"call {self.service} again")
            except RopewayError as error:
                call.end(error)

        def over(how: bytes | BaseException) -> None:
            calls.pending.pop(id, None)
            under_way.discard(call)
            ended(how if isinstance(how, bytes) else self._reason(how, timeout_s))

        id = self._new_id()
        call = Begun(over)
        calls.pending[id] = answered
        try:
            self._send(gateway, request, id, timeout_s, call.end)
        except (TypesError, WireError, LinkError):
            del calls.pending[id]
            return None  # ``call`` says so
        call.expiry = loop.call_at(began + timeout_s, call.expire)
        under_way.add(call)
        return call

    async def _try_again(self, request: Request, call: Begun, began: float, timeout_s: float) -> None:
        """Make a call once more that was not served; it may be in a moment."""
        deadline = began + timeout_s
        try:
            if not await self._calls.may_try_again(self, began, deadline):
                raise NotServed(self.service)
            call.end(await self.call(request, max(deadline - asyncio.get_running_loop().time(), 0.0)))
        except RopewayError as error:
            call.end(error)

    def _new_id(self) -> str:
        return f"call_service:{self.service}:{next(self._calls.numbers)}"

    def _reason(self, error: BaseException, timeout_s: float) -> BaseException:
        """Return why a call has no answer, as its caller is to be told."""
        match error:
            case TimeoutError():
                return NotServed(self.service) if self.available is False else CallTimeout(self.service, timeout_s)
            case GraphUnavailable() if not self.closed:
                return ProviderLost(self.service, f"the link to {self._calls.graph.name} was lost")
            case TypesError() | WireError() | LinkError():
                return CallFailed(self.service, str(error))
        return error

    def _read(self, peer: Peer, response: ops.ServiceResponse, timeout_s: float) -> bytes:
        if not response.result:
            raise received(self.service, response.values, response.ropeway, kind="service", timeout_s=timeout_s)
        body = self._calls.bodies.of(f"{self.type}_Response")
        return body.read(response.values, response.compression, peer.limit_bytes)

    def _send(self, peer: Peer, request: Request, id: str, left_s: float, unsent: Callable[[Exception], None]) -> None:
        """Send a call. Raises ``TypesError``, ``WireError``, ``LinkError``."""
        calls = self._calls
        graph = calls.graph
        gateway = peer.dialect is ROPEWAY
        if not gateway:
            left_s -= min(_EARLIER_S, left_s / 4)  # so that the server says first why there is no answer
        message: dict[str, Any] = {
            "op": "call_service",
            "id": id,
            "service": self.service,
            "type": graph.spelling.type_name(self.type) if graph.spelling.ros1 else self.type,
            "args": None,
            "timeout": round(max(left_s, 0.001), 3),
        }
        if gateway:
            message["ropeway"] = call_note(request, graph.gateway_id, self.delivery.encoding)
        body = calls.bodies.of(f"{self.type}_Request")
        peer.send_op(
            message,
            payload=body.written(request.payload),
            field="args",
            codec=body.codec,
            encoding=self.delivery.encoding if gateway else self.encoding,
            priority=self._lane,
            on_unsent=unsent,
        )

    async def _ask(self, peer: Peer, request: Request, deadline: float, timeout_s: float) -> bytes:
        calls = self._calls
        loop = asyncio.get_running_loop()
        id = self._new_id()
        answer: asyncio.Future[ops.ServiceResponse] = loop.create_future()
        answered = calls.pending[id] = into(answer)
        try:
            self._send(peer, request, id, deadline - loop.time(), answered)
            expiry = loop.call_at(deadline, answered, TimeoutError())
            try:
                response = await answer
            finally:
                expiry.cancel()
            return self._read(peer, response, timeout_s)
        except GraphUnavailable:
            raise ProviderLost(self.service, f"the link to {calls.graph.name} was lost") from None
        except (TypesError, WireError, LinkError) as error:
            raise CallFailed(self.service, str(error)) from error
        finally:
            calls.pending.pop(id, None)

    async def _leave(self) -> None:
        self._calls.clients.pop(self, None)
        await self._again.close()


class RemoteService(LinkProvider):
    """A service that we serve on the far graph."""

    kind = "service"
    parts = ("Request", "Response")

    def __init__(self, calls: Calls, service: str, type: str, handler: ServiceHandler, delivery: Delivery) -> None:
        super().__init__(calls, service, type, delivery)
        self.service = service
        self._handler = handler
        self._begins = handler.begin if isinstance(handler, BeginningHandler) else None
        self._answering = Chores()
        self._begun: set[Begun] = set()

    def connected(self, peer: Peer) -> None:
        """Announce the service on a new connection. Raises ``UnknownType`` if the peer needs the definition."""
        about = self._announcing(peer)
        type = self._calls.graph.spelling.type_name(self.type)
        peer.send(ops.AdvertiseService(service=self.service, type=type, **about))

    def disconnected(self) -> None:
        """Drop the calls under way: the connection is gone, so nobody waits for the answers."""
        self._peer = None
        self._give_up()
        self._answering.cancel()

    def _give_up(self) -> None:
        for call in list(self._begun):
            call.give_up()

    def called(self, op: ops.CallService, peer: Peer) -> None:
        """Take a call."""
        self._asked = op.compression
        if len(self._answering.tasks) + len(self._begun) >= CALLS_LIMIT:
            self._fail(op, peer, CallFailed(self.service, f"{self.service} is busy with {CALLS_LIMIT} calls"))
            return
        try:
            request = self._request(op, peer)
        except RopewayError as error:
            self._fail(op, peer, error)
            return
        if self._begins is None or not self._begin(op, peer, request, self._begins):
            self._answering.start(self._answer(op, peer, request), f"answer {self.service}")

    def _request(self, op: ops.CallService, peer: Peer) -> Request:
        note = read_note(op.ropeway)
        timeout_s = op.timeout if op.timeout is not None and op.timeout > 0 else None
        payload = self._calls.bodies.of(f"{self.type}_Request").read(op.args, op.compression, peer.limit_bytes)
        return Request(payload, note.id, note.via, note.caller, timeout_s)

    def _begin(
        self, op: ops.CallService, peer: Peer, request: Request, begins: Callable[[Request, Ended], Begun | None]
    ) -> bool:
        """Begin to answer now; return false, having done nothing, where that takes a task."""

        def over(how: bytes | BaseException) -> None:
            self._begun.discard(call)
            if not isinstance(how, asyncio.CancelledError):
                self._reply(op, peer, how)

        begun = begins(request, over)
        if begun is None:
            return False
        call = begun
        self._begun.add(call)
        return True

    async def _answer(self, op: ops.CallService, peer: Peer, request: Request) -> None:
        how: bytes | BaseException
        try:
            how = bytes(await self._handler(request))
        except Exception as error:  # a handler is somebody else's code; its failure is the call's
            how = error
        self._reply(op, peer, how)

    def _reply(self, op: ops.CallService, peer: Peer, how: bytes | BaseException) -> None:
        """Answer a call, of which this came."""
        if isinstance(how, BaseException):
            if not isinstance(how, RopewayError):
                failed(log, "%s: the handler of %s failed", self._calls.graph.name, self.service, error=how)
            self._fail(op, peer, how)
            return
        try:
            body = self._calls.bodies.of(f"{self.type}_Response")
            message = {"op": "service_response", "service": op.service, "values": None, "result": True}
            if op.id is not ops.ABSENT:
                message["id"] = op.id
            peer.send_op(
                message,
                payload=body.written(how),
                field="values",
                codec=body.codec,
                encoding=answer_encoding(self.delivery, peer, op),
                priority=self._lane,
                on_unsent=lambda error: self._fail(op, peer, error),
            )
        except RopewayError as error:
            self._fail(op, peer, error)

    def _fail(self, op: ops.CallService, peer: Peer, error: BaseException) -> None:
        note, text = failure(error)
        rosgw = peer.dialect is ROSGW  # it wants an object, even where there is none
        peer.send_op(
            ops.ServiceResponse(
                id=op.id,
                service=op.service,
                values={} if rosgw else text,
                result=False,
                ropeway=note if peer.dialect is ROPEWAY else None,
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
        self._give_up()
        await self._answering.close()
