"""Services called and served over a link. They outlive connections: each new one announces what is served."""

from __future__ import annotations

import asyncio
import logging
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

    async def _ask(self, peer: Peer, request: Request, deadline: float, timeout_s: float) -> bytes:
        calls = self._calls
        loop = asyncio.get_running_loop()
        graph = calls.graph
        id = f"call_service:{self.service}:{next(calls.numbers)}"
        answer: asyncio.Future[ops.ServiceResponse] = loop.create_future()

        def unsent(error: Exception) -> None:
            if not answer.done():
                answer.set_exception(error)

        gateway = peer.dialect is ROPEWAY
        left_s = deadline - loop.time()
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
        calls.pending[id] = answer
        try:
            peer.send_op(
                message,
                payload=body.written(request.payload),
                field="args",
                codec=body.codec,
                encoding=self.delivery.encoding if gateway else self.encoding,
                priority=self._lane,
                on_unsent=unsent,
            )
            expiry = loop.call_at(deadline, unsent, TimeoutError())
            try:
                response = await answer
            finally:
                expiry.cancel()
            if not response.result:
                raise received(self.service, response.values, response.ropeway, kind="service", timeout_s=timeout_s)
            body = calls.bodies.of(f"{self.type}_Response")
            return body.read(response.values, response.compression, peer.limit_bytes)
        except GraphUnavailable:
            raise ProviderLost(self.service, f"the link to {graph.name} was lost") from None
        except (TypesError, WireError, LinkError) as error:
            raise CallFailed(self.service, str(error)) from error
        finally:
            calls.pending.pop(id, None)

    async def _leave(self) -> None:
        self._calls.clients.pop(self, None)


class RemoteService(LinkProvider):
    """A service that we serve on the far graph."""

    kind = "service"
    parts = ("Request", "Response")

    def __init__(self, calls: Calls, service: str, type: str, handler: ServiceHandler, delivery: Delivery) -> None:
        super().__init__(calls, service, type, delivery)
        self.service = service
        self._handler = handler
        self._answering = Chores()

    def connected(self, peer: Peer) -> None:
        """Announce the service on a new connection. Raises ``UnknownType`` if the peer needs the definition."""
        about = self._announcing(peer)
        type = self._calls.graph.spelling.type_name(self.type)
        peer.send(ops.AdvertiseService(service=self.service, type=type, **about))

    def disconnected(self) -> None:
        """Drop the calls under way: the connection is gone, so nobody waits for the answers."""
        self._peer = None
        self._answering.cancel()

    def called(self, op: ops.CallService, peer: Peer) -> None:
        """Take a call."""
        self._asked = op.compression
        if len(self._answering.tasks) >= CALLS_LIMIT:
            self._fail(op, peer, CallFailed(self.service, f"{self.service} is busy with {CALLS_LIMIT} calls"))
            return
        self._answering.start(self._answer(op, peer), f"answer {self.service}")

    async def _answer(self, op: ops.CallService, peer: Peer) -> None:
        note = read_note(op.ropeway)
        bodies = self._calls.bodies
        timeout_s = op.timeout if op.timeout is not None and op.timeout > 0 else None
        try:
            payload = bodies.of(f"{self.type}_Request").read(op.args, op.compression, peer.limit_bytes)
            response = bytes(await self._handler(Request(payload, note.id, note.via, note.caller, timeout_s)))
            body = bodies.of(f"{self.type}_Response")
            message = {"op": "service_response", "service": op.service, "values": None, "result": True}
            if op.id is not ops.ABSENT:
                message["id"] = op.id
            peer.send_op(
                message,
                payload=body.written(response),
                field="values",
                codec=body.codec,
                encoding=answer_encoding(self.delivery, peer, op),
                priority=self._lane,
                on_unsent=lambda error: self._fail(op, peer, error),
            )
        except RopewayError as error:
            self._fail(op, peer, error)
        except Exception as error:  # a handler is somebody else's code; its failure is the call's
            failed(log, "%s: the handler of %s failed", self._calls.graph.name, self.service)
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
        await self._answering.close()
