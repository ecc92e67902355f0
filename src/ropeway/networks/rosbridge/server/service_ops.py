"""Carries out a client's operations on services: it calls those of the graph, and serves its own to it."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import (
    CallFailed,
    InvalidOperation,
    InvalidTypeName,
    NotServed,
    ProviderLost,
    RopewayError,
    TypeConflict,
    WireError,
)
from ropeway.graph.begun import Begun
from ropeway.graph.calls import Request
from ropeway.hub.kept_clients import KeptClients
from ropeway.limits import CALLS_PER_CLIENT, LONGEST_CALL_S, SERVICES_PER_CLIENT
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.server.bodies import (
    answer_encoding,
    codec_of,
    decode_args,
    failure_note,
    passage,
    text_of,
)
from ropeway.networks.rosbridge.server.offers import Offers
from ropeway.networks.rosbridge.server.rosapi_calls import RosapiCalls
from ropeway.networks.rosbridge.server.service_offers import OfferedService
from ropeway.tasks import end

if TYPE_CHECKING:
    from ropeway.hub.calls import ViewClient
    from ropeway.networks.rosbridge.server.host import SessionHost
    from ropeway.types import MessageCodec

__all__ = ["ServiceOps"]

log = logging.getLogger("ropeway.server")

_SERVER_S: Final = 1.0  # a server that was seen and not reached yet is waited for so long, besides the call's own time
_NAMES_LIMIT: Final = 256  # spellings of names that are looked up once


class ServiceOps:
    """The calls and the services of one client."""

    def __init__(self, session: SessionHost, *, call_timeout_s: float) -> None:
        self.session = session
        self.call_timeout_s = call_timeout_s
        self.called = 0
        self.offered: Offers[OfferedService] = Offers(
            session, "service", "srv", ("Request", "Response"), SERVICES_PER_CLIENT
        )
        self._calls: dict[asyncio.Task[None], ops.CallService] = {}
        self._begun: dict[Begun, ops.CallService] = {}  # without a task
        self._rosapi = RosapiCalls(session.peer, session.turns, self._fail)
        self._clients = KeptClients(session.view)
        self._names: dict[str, tuple[str, bool]] = {}  # by what clients write: the name, and whether rosapi serves it

    async def leave(self) -> None:
        """Clean up after a client that has left: its calls are given up, its services withdrawn."""
        for call in list(self._begun):
            call.give_up()
        await end(*self._calls)
        await self._rosapi.close()
        await self._clients.close()
        await self.offered.leave()

    async def give_up(self, reason: str) -> None:
        """Answer the calls that are under way: they fail for this reason."""
        begun, under_way = dict(self._begun), dict(self._calls)
        for call in begun:
            call.give_up()
        await end(*under_way)
        for op in (*begun.values(), *under_way.values(), *await self._rosapi.close()):
            self.refuse(op, ProviderLost(op.name, reason))

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
        if len(self._calls) + len(self._begun) + self.session.turns.questions >= CALLS_PER_CLIENT:
            self.refuse(op, CallFailed(op.name, f"too many calls: {CALLS_PER_CLIENT} of this client are under way"))
            return
        session = self.session
        try:
            name, is_own = self._names.get(op.service) or self._look_up(op.service)
            session.access.check("call_service", name)
            if is_own:
                assert session.rosapi is not None
                if session.access.role.audited:
                    session.access.command("call_service", name, json.dumps(op.args, default=repr).encode())
                self._rosapi.add(op, session.rosapi.question(name, op.args))
                return
            if session.gateway and self._begin(op, name):
                return
        except (RopewayError, ValueError) as error:
            self.refuse(op, error)
            return
        task = asyncio.get_running_loop().create_task(self._answer(op, name), name=f"call of {op.service[:200]}")
        self._calls[task] = op
        task.add_done_callback(partial(self._ended, op))

    def _begin(self, op: ops.CallService, name: str) -> bool:
        """Begin a call of a gateway whose client is kept; return false, having done nothing, where that takes a task.

        Raises ``TypesError``, ``WireError``.
        """
        session, extra = self.session, op.ropeway or {}
        client = self._clients.kept.get((name, op.type)) if op.type else None
        if client is None or not client.available or "definition" in extra or session.access.role.audited:
            return False
        type = client.type
        codec = codec_of(session, type + "_Response")
        payload = decode_args(session, op.args, op.compression, type + "_Request")
        timeout_s = self._limit(op)

        def over(how: bytes | BaseException) -> None:
            del self._begun[call]
            session.requests_bytes -= len(payload)
            if isinstance(how, bytes):
                self._reply(op, how, codec)
            elif not isinstance(how, asyncio.CancelledError):
                self._fail(op, how)

        begun = client.begin(Request(payload, *passage(session, extra), timeout_s), timeout_s, over)
        if begun is None:
            return False
        call = begun
        self._begun[call] = op
        self._clients.kept.move_to_end((name, type))
        session.requests_bytes += len(payload)
        op.args = None  # in CDR it takes least
        return True

    def _limit(self, op: ops.CallService) -> float:
        """Return how long a call may take."""
        asked_s = self.call_timeout_s if op.timeout is None else op.timeout
        return min(asked_s, LONGEST_CALL_S) if asked_s > 0 else LONGEST_CALL_S

    def _look_up(self, service: str) -> tuple[str, bool]:
        """Return the name of a service that is called, and whether our rosapi serves it. Raises ``InvalidName``."""
        session = self.session
        name = session.names.resolve(service.partition("#")[0])
        if len(self._names) >= _NAMES_LIMIT:
            self._names.clear()
        self._names[service] = found = (name, session.rosapi is not None and session.rosapi.serves(name))
        return found

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
        session = self.session
        held = 0
        try:
            extra = op.ropeway or {}
            client = self._clients.kept.get((name, op.type)) if session.gateway and op.type else None
            if client is not None and client.available:  # so its type is right as well
                type, known = client.type, True
            else:
                client = None
                type, known = self._type(op, name)
            if "definition" in extra:
                session.learn(type, extra)
            codec = codec_of(session, type + "_Response")
            payload = decode_args(session, op.args, op.compression, type + "_Request")
            if session.access.role.audited:
                session.access.command("call_service", name, payload)
            op.args = None  # in CDR it takes least
            timeout_s = self._limit(op)
            request = Request(payload, *passage(session, extra), timeout_s)
            held = len(payload)
            session.requests_bytes += held
            if client is None:
                client = await self._found(name, type, timeout_s, wait=known)
            else:
                self._clients.kept.move_to_end((name, type))
            response = await client.call(request, timeout_s)
        except (RopewayError, ValueError) as error:
            self.refuse(op, error)
            return
        finally:
            session.requests_bytes -= held
        self._reply(op, response, codec)

    def _reply(self, op: ops.CallService, response: bytes, codec: MessageCodec | None) -> None:
        """Answer a call."""
        session = self.session
        message = {"op": "service_response", "service": op.service, "values": None, "result": True}
        if op.id is not ops.ABSENT:
            message["id"] = op.id
        try:
            session.peer.send_op(
                message,
                payload=response,
                field="values",
                codec=codec,
                encoding=answer_encoding(session, op),
                fragment_size=op.fragment_size,
                on_unsent=partial(self.refuse, op),
            )
        except (RopewayError, ValueError) as error:
            self.refuse(op, error)

    async def _found(self, name: str, type: str, timeout_s: float, *, wait: bool) -> ViewClient:
        """Return the client for a service; with ``wait`` somebody may serve it in a moment."""
        if self.session.view.service_types(name):
            client = await self._clients.take(name, type)
        else:
            client = await self._find(name, type, timeout_s, wait=wait)
        if client.available is False and client.listed:
            await client.wait_available(_SERVER_S)
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
        return await self._clients.keep(name, type, client)

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
        await self.offered.add(op, partial(OfferedService, self.session, op), lambda service: service.restart(op))

    async def unadvertise(self, op: ops.UnadvertiseService) -> None:
        """Withdraw a service of the client."""
        await self.offered.withdraw(op.service)

    def response(self, op: ops.ServiceResponse) -> None:
        """Take the client's answer to a call."""
        service = self.offered.get(op.service) or self.offered.found(op.service)
        if op.id is ops.ABSENT:
            raise InvalidOperation("", f"Received service response without an id for service {op.service}")
        service.answered(op)

    def invalid_response(self, message: Mapping[str, Any], error: WireError) -> None:
        """Fail the call whose answer cannot be understood, so that nobody waits for it."""
        id = message.get("id")
        for service in self.offered.values():
            if isinstance(id, str) and id in service.pending:
                service.fail(id, CallFailed(service.name, text_of(error)))
