"""Carries out a client's operations on services: it calls those of the graph, and serves its own to it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from ropeway import aio
from ropeway.errors import (
    CallError,
    CallFailed,
    CallTimeout,
    InvalidOperation,
    InvalidTypeName,
    NotServed,
    ProviderLost,
    RopewayError,
    TypeConflict,
    TypesError,
    WireError,
)
from ropeway.graph.base import Delivery
from ropeway.graph.calls import Request
from ropeway.limits import CALLS_PER_CLIENT, CALLS_PER_OFFERED_SERVICE, LONGEST_CALL_S, SERVICES_PER_CLIENT
from ropeway.networks.rosbridge.client.call_notes import call_note, received
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.server.bodies import (
    answer_encoding,
    codec_of,
    decode_args,
    decode_body,
    failure_note,
    known_type_of,
    passage,
    text_of,
)
from ropeway.networks.rosbridge.server.rosapi_calls import RosapiCalls
from ropeway.tasks import end

if TYPE_CHECKING:
    from ropeway.hub.calls import ViewClient, ViewService
    from ropeway.networks.rosbridge.server.host import SessionHost

__all__ = ["ServiceOps", "tell_state"]

log = logging.getLogger("ropeway.server")

_SERVER_S: Final = 1.0  # a server that was seen and not reached yet is waited for so long, besides the call's own time
_CLIENTS_LIMIT: Final = 32  # services that one client calls again soon


class ServiceOps:
    """The calls and the services of one client."""

    def __init__(self, session: SessionHost, *, call_timeout_s: float) -> None:
        self.session = session
        self.call_timeout_s = call_timeout_s
        self.called = 0
        self.offered: dict[str, OfferedService] = {}  # by the name that the client gave
        self._calls: dict[asyncio.Task[None], ops.CallService] = {}
        self._rosapi = RosapiCalls(session.peer, session.turns, self._fail)
        self._clients: dict[tuple[str, str], ViewClient] = {}

    async def leave(self) -> None:
        """Clean up after a client that has left: its calls are given up, its services withdrawn."""
        await end(*self._calls)
        await self._rosapi.close()
        for client in self._clients.values():
            await client.close()
        self._clients.clear()
        for service in list(self.offered.values()):
            await service.close("its provider has left")
        self.offered.clear()

    async def give_up(self, reason: str) -> None:
        """Answer the calls that are under way: they fail for this reason."""
        under_way = dict(self._calls)
        await end(*under_way)
        for op in (*under_way.values(), *await self._rosapi.close()):
            self.refuse(op, ProviderLost(op.name, reason))

    @property
    def questions(self) -> int:
        """The number of rosapi calls not answered yet."""
        return len(self._rosapi)

    def status(self) -> Iterator[dict[str, Any]]:
        """Yield one row per service that the client serves."""
        for service in self.offered.values():
            yield {
                "name": service.service,
                "type": service.type,
                "calls": service.count,
                "pending": len(service.pending),
                "taken_by": service.taken_by,
            }

    # ── calling ────────────────────────────────────────────────────────────────────────────────────────────────

    def call(self, op: ops.CallService) -> None:
        """Call a service for the client; it is answered exactly once, unless the client leaves."""
        self.called += 1
        if len(self._calls) + len(self._rosapi) >= CALLS_PER_CLIENT:
            self.refuse(op, CallFailed(op.name, f"too many calls: {CALLS_PER_CLIENT} of this client are under way"))
            return
        session = self.session
        try:
            name = session.names.resolve(op.name)
            session.access.check("call_service", name)
            if session.rosapi is not None and session.rosapi.serves(name):
                self._rosapi.add(op, session.rosapi.question(name, op.args))
                return
        except (RopewayError, ValueError) as error:
            self.refuse(op, error)
            return
        task = asyncio.create_task(self._answer(op, name), name=f"call of {op.service[:200]}")
        self._calls[task] = op
        task.add_done_callback(partial(self._ended, op))

    def _ended(self, op: ops.CallService, task: asyncio.Task[None]) -> None:
        self._calls.pop(task, None)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._fail(op, error)

    def _fail(self, op: ops.CallService, error: BaseException) -> None:
        """Answer a call that failed, foreseen or not."""
        if not isinstance(error, (RopewayError, ValueError)):
            log.error("%s: a call of %s failed", self.session.peer.connection.peer, op.service, exc_info=error)
            error = CallFailed(op.name, "internal error")
        self.refuse(op, error)

    async def _answer(self, op: ops.CallService, name: str) -> None:
        try:
            await self._call(op, name)
        except (RopewayError, ValueError) as error:
            self.refuse(op, error)

    async def _call(self, op: ops.CallService, name: str) -> None:
        session = self.session
        extra = op.ropeway or {}
        type, known = self._type(op, name)
        session.learn(type, extra)
        codec = codec_of(session, type + "_Response")
        payload = decode_args(session, op.args, op.compression, type + "_Request")
        op.args = None  # in CDR it takes least
        timeout_s = self._timeout_s(op.timeout)
        request = Request(payload, timeout_s=timeout_s, **passage(session, extra))
        with session.holding(len(payload)):
            if session.view.service_types(name):
                client = await self._client(name, type)
            else:
                client = await self._find(name, type, timeout_s, wait=known)
            if client.available is False and client.listed:
                await client.wait_available(_SERVER_S)
            response = await client.call(request, timeout_s)
        session.peer.send_op(
            ops.ServiceResponse(service=op.service, values=None, result=True, id=op.id),
            payload=response,
            field="values",
            codec=codec,
            encoding=answer_encoding(session, op),
            fragment_size=op.fragment_size,
            on_unsent=partial(self.refuse, op),
        )

    async def _client(self, name: str, type: str) -> ViewClient:
        """Return the client for a service, kept for further calls."""
        client = self._clients.pop((name, type), None) or await self.session.view.create_client(name, type)
        return await self._keep(name, type, client)

    async def _keep(self, name: str, type: str, client: ViewClient) -> ViewClient:
        """Keep a client for further calls, or take the one that is kept; that not used for longest goes."""
        other = self._clients.pop((name, type), None)  # of a call that came meanwhile
        if other is not None and other is not client:
            await client.close()
            client = other
        self._clients[name, type] = client
        while len(self._clients) > _CLIENTS_LIMIT:
            oldest = next(iter(self._clients))
            idle = self._clients.pop(oldest)
            if idle.busy:
                self._clients[oldest] = idle
                break
            await idle.close()
        return client

    async def _find(self, name: str, type: str, timeout_s: float, *, wait: bool) -> ViewClient:
        """Return the client for a service that nobody is known to serve; with ``wait`` it may appear in a moment.

        Raises ``NotServed`` or ``CallTimeout``. Few are looked for at a time: each takes parts of the graph.
        """
        async with self.session.searching(name, timeout_s):
            client = await self.session.view.create_client(name, type)
            try:
                if client.available is False and not client.listed:
                    if not wait:
                        raise NotServed(name)  # at once, as rosbridge does, which does not know the type then
                    await client.find(timeout_s)
            except BaseException:
                await client.close()
                raise
        return await self._keep(name, type, client)

    def _type(self, op: ops.CallService, name: str) -> tuple[str, bool]:
        """Return the type of a service, and whether to wait for it.

        It is as it is served, else as the client says, if it says something sensible. A gateway knows what it wants.
        """
        session = self.session
        try:
            given = session.registry.canonical(op.type, "srv") if op.type else ""
        except InvalidTypeName:
            given = ""
        types = session.view.service_types(name)
        if session.gateway and given:
            if types and given not in types:
                raise TypeConflict(name, types[0], given)
            return given, True
        if types:
            return types[0], True
        if given and session.registry.has(given) and given.split("/")[1] == "srv":
            return given, False
        raise NotServed(name)

    def _timeout_s(self, asked: float | None) -> float:
        timeout_s = self.call_timeout_s if asked is None else asked
        return min(timeout_s, LONGEST_CALL_S) if timeout_s > 0 else LONGEST_CALL_S

    def refuse(self, op: ops.CallService, error: Exception) -> None:
        """Answer a call that failed."""
        note = failure_note(self.session, error)
        values = text_of(error)
        reply = ops.ServiceResponse(service=op.service, values=values, result=False, id=op.id, ropeway=note)
        self.session.peer.send_op(reply)

    def invalid_call(self, message: Mapping[str, Any], error: WireError) -> None:
        """Answer a call that cannot be understood, if it says what it is about."""
        service = message.get("service")
        id = error.id if isinstance(error, InvalidOperation) else ops.ABSENT
        if isinstance(service, str) or ops.present(id):
            op = ops.CallService(service=service if isinstance(service, str) else "", args=None, id=id)
            self.refuse(op, error)

    # ── serving ────────────────────────────────────────────────────────────────────────────────────────────────

    async def advertise(self, op: ops.AdvertiseService) -> None:
        """Offer a service that the client serves."""
        session = self.session
        name = session.names.resolve(op.service)
        session.access.check("advertise_service", name)
        type = await known_type_of(session, op.type, "srv")
        if type.split("/")[1] != "srv":
            raise InvalidTypeName(op.type)
        session.learn(type, op.ropeway)
        for part in ("_Request", "_Response"):
            codec_of(session, type + part)  # what the client cannot read, it cannot serve
        known = self.offered.get(op.service)
        if known is None and len(self.offered) >= SERVICES_PER_CLIENT:
            raise InvalidOperation("", f"a client may have {SERVICES_PER_CLIENT} services at most")
        if known is not None:
            text = f"Duplicate service advertised. Overwriting {op.service}."
            session.complain("advertise_service", op.service, text, op.id)
            if known.type == type:  # the name stays taken meanwhile
                known.restart(op)
                return
            del self.offered[op.service]
            await known.close("it was advertised again with another type")
        service = self.offered[op.service] = OfferedService(session, op, name, type)
        try:
            await service.open()
        except (RopewayError, ValueError):
            del self.offered[op.service]
            raise

    async def unadvertise(self, op: ops.UnadvertiseService) -> None:
        """Withdraw a service of the client."""
        service = self.offered.pop(op.service, None)
        if service is None:
            raise InvalidOperation(
                "", f"Service {op.service} has not been advertised via rosbridge, can't unadvertise."
            )
        await service.close("its provider has withdrawn it")

    def response(self, op: ops.ServiceResponse) -> None:
        """Take the client's answer to a call."""
        service = self._offered(op.service)
        if not ops.present(op.id):
            raise InvalidOperation("", f"Received service response without an id for service {op.service}")
        service.answered(op)

    def _offered(self, service: str) -> OfferedService:
        found = self.offered.get(service)
        if found is None:
            name = self.session.names.resolve(service)
            found = next((s for s in self.offered.values() if s.name == name), None)
        if found is None:
            raise InvalidOperation("", f"Service {service} has not been advertised via rosbridge.")
        return found

    def invalid_response(self, message: Mapping[str, Any], error: WireError) -> None:
        """Fail the call whose answer cannot be understood, so that nobody waits for it."""
        id = message.get("id")
        for service in self.offered.values():
            if isinstance(id, str) and id in service.pending:
                service.fail(id, CallFailed(service.name, text_of(error)))


class OfferedService:
    """A service that the client serves; ``service`` is its name as the client gave it, ``name`` that on the graph."""

    def __init__(self, session: SessionHost, op: ops.AdvertiseService, name: str, type: str) -> None:
        self.session, self.service, self.name, self.type = session, op.service, name, type
        self.pending: dict[str, asyncio.Future[bytes]] = {}
        self.count = 0
        self.taken_by = ""
        self.closed = False
        self._compression = op.compression
        self._inner: ViewService | None = None

    async def open(self) -> None:
        """Serve the service on the graph, or wait until its holder leaves. Raises what the graph raises."""
        delivery = Delivery(encoding=self._compression or "auto")
        self._inner = await self.session.view.create_service(self.name, self.type, self._handle, delivery=delivery)
        self._inner.on_state(self._state)

    def _state(self, taken_by: str) -> None:
        tell_state(self.session, "service", self.service, self.taken_by, taken_by)
        self.taken_by = taken_by

    def restart(self, op: ops.AdvertiseService) -> None:
        """Fail all calls under way: the client advertised the service once more."""
        self.fail_all("its provider began anew")
        self._compression = op.compression
        self.count = 0

    async def _handle(self, request: Request) -> bytes:
        session = self.session
        if self.closed or session.gone:
            raise ProviderLost(self.name, "its provider has left")
        if len(self.pending) >= CALLS_PER_OFFERED_SERVICE:
            raise CallFailed(self.name, f"too many calls: {CALLS_PER_OFFERED_SERVICE} of {self.name} are under way")
        self.count += 1
        id = f"service_request:{self.service}:{self.count}"
        answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        self.pending[id] = answer
        timeout_s = min(request.timeout_s or LONGEST_CALL_S, LONGEST_CALL_S)
        op = ops.CallService(id=id, service=self.service, args=None)
        if session.gateway:
            op.timeout = timeout_s
            op.ropeway = call_note(request, session.gateway_id)
        try:
            session.peer.send_op(
                op,
                payload=request.payload,
                field="args",
                codec=codec_of(session, self.type + "_Request"),
                encoding=self._compression or "auto",
                on_unsent=lambda error: self.fail(id, CallFailed(self.name, str(error))),
            )
            async with aio.timeout(timeout_s):
                return await answer
        except TimeoutError:
            raise CallTimeout(self.name, timeout_s) from None
        finally:
            if self.pending.get(id) is answer:
                del self.pending[id]

    def answered(self, op: ops.ServiceResponse) -> None:
        """Take an answer: a response, or a text (or nothing, with a false ``result``) that fails the call.

        A false ``result`` with a response counts for nothing, as with rosbridge: what a ROS 2 service has to say stands
        in its response. Raises ``InvalidOperation`` for an answer that nobody waits for, ``TypesError`` for a bad one.
        """
        answer = self.pending.get(op.id) if isinstance(op.id, str) else None
        if answer is None or answer.done():
            raise InvalidOperation("", f"Received service response for unrecognized id: {str(op.id)[:200]}")
        if isinstance(op.values, str) or (not op.result and op.values is None):
            self.fail(op.id, received(self.name, op.values, op.ropeway, kind="service", timeout_s=0.0))
            return
        try:
            if op.values is None and codec_fields(self.session, self.type):
                raise InvalidOperation("", "Expected a values field but none was found.")
            payload = decode_body(self.session, op.values, op.compression, self.type + "_Response")
        except (TypesError, WireError) as error:
            self.fail(op.id, CallFailed(self.name, text_of(error)))
            raise
        answer.set_result(payload)

    def fail(self, id: str, error: CallError) -> None:
        """Fail one call."""
        answer = self.pending.get(id)
        if answer is not None and not answer.done():
            answer.set_exception(error)

    def fail_all(self, reason: str) -> None:
        """Fail all calls under way."""
        for id in list(self.pending):
            self.fail(id, ProviderLost(self.name, reason))
        self.pending.clear()

    async def close(self, reason: str) -> None:
        """Stop serving it; calls under way fail at once."""
        self.closed = True
        self.fail_all(reason)
        await asyncio.sleep(0)  # who called is told why, before the graph says that nobody is there
        if self._inner is not None:
            await self._inner.close()


def codec_fields(session: SessionHost, type: str) -> bool:
    """Return whether the response of a service has fields."""
    codec = codec_of(session, type + "_Response")
    return codec is None or bool(codec.fields)


def tell_state(session: SessionHost, kind: str, name: str, before: str, taken_by: str) -> None:
    """Say that somebody else serves a name of the client, or that the client does now."""
    if taken_by:
        session.complain(
            f"advertise_{kind}",
            name,
            f"{kind.capitalize()} {name} is already offered by {taken_by}; this one takes over when it leaves",
        )
        if session.gateway:
            reason = f"{kind} {name} is already offered by {taken_by}"
            session.peer.send({"op": "refused", kind: name, "reason": reason, "taken_by": taken_by})
    elif before:
        session.inform(f"{kind.capitalize()} {name} is now offered by this client")
        if session.gateway:
            session.peer.send({"op": "granted", kind: name})
