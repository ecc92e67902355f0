"""A service that a client serves, and the calls that it answers."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from ropeway.errors import (
    CallError,
    CallFailed,
    CallTimeout,
    InvalidOperation,
    ProviderLost,
    RopewayError,
    TypesError,
    WireError,
)
from ropeway.graph.base import Delivery
from ropeway.graph.begun import Begun, Ended, Handler, into
from ropeway.graph.calls import Request
from ropeway.limits import CALLS_PER_OFFERED_SERVICE, LONGEST_CALL_S
from ropeway.networks.rosbridge.client.call_notes import call_note, received
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.server.bodies import codec_of, decode_body, text_of

if TYPE_CHECKING:
    from ropeway.hub.calls import ViewService
    from ropeway.networks.rosbridge.server.host import SessionHost

__all__ = ["OfferedService", "tell_state"]


class OfferedService:
    """A service that the client serves; ``service`` is its name as the client gave it, ``name`` that on the graph."""

    def __init__(self, session: SessionHost, op: ops.AdvertiseService, name: str, type: str) -> None:
        self.session, self.service, self.name, self.type = session, op.service, name, type
        self.pending: dict[str, Begun] = {}
        self.count = 0
        self.taken_by = ""
        self.closed = False
        self._compression = op.compression
        self._inner: ViewService | None = None

    async def open(self) -> None:
        """Serve the service on the graph, or wait until its holder leaves. Raises what the graph raises."""
        delivery = Delivery(encoding=self._compression or "auto")
        handler = Handler(self._answer, self._begin)
        self._inner = await self.session.view.create_service(self.name, self.type, handler, delivery=delivery)
        self._inner.on_state(self._state)

    def _state(self, taken_by: str) -> None:
        tell_state(self.session, "service", self.service, self.taken_by, taken_by)
        self.taken_by = taken_by

    def restart(self, op: ops.AdvertiseService) -> None:
        """Fail all calls under way: the client advertised the service once more."""
        self.fail_all("its provider began anew")
        self._compression = op.compression
        self.count = 0

    async def _answer(self, request: Request) -> bytes:
        answer: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
        call = self._ask(request, into(answer))
        try:
            return await answer
        finally:
            call.give_up()

    def _begin(self, request: Request, ended: Ended) -> Begun | None:
        try:
            return self._ask(request, ended)
        except RopewayError:
            return None  # ``_answer`` says so

    def _ask(self, request: Request, ended: Ended) -> Begun:
        """Send a call to the client. Raises ``CallError``, ``TypesError``, ``LinkError``."""
        session = self.session
        if self.closed or session.gone:
            raise ProviderLost(self.name, "its provider has left")
        if len(self.pending) >= CALLS_PER_OFFERED_SERVICE:
            raise CallFailed(self.name, f"too many calls: {CALLS_PER_OFFERED_SERVICE} of {self.name} are under way")
        self.count += 1
        id = f"service_request:{self.service}:{self.count}"
        timeout_s = min(request.timeout_s or LONGEST_CALL_S, LONGEST_CALL_S)
        message: dict[str, Any] = {"op": "call_service", "id": id, "service": self.service, "args": None}
        if session.gateway:
            message["timeout"] = timeout_s
            message["ropeway"] = call_note(request, session.gateway_id)

        def over(how: bytes | BaseException) -> None:
            if self.pending.get(id) is call:
                del self.pending[id]
            ended(CallTimeout(self.name, timeout_s) if isinstance(how, TimeoutError) else how)

        call = self.pending[id] = Begun(over)
        try:
            session.peer.send_op(
                message,
                payload=request.payload,
                field="args",
                codec=codec_of(session, self.type + "_Request"),
                encoding=self._compression or "auto",
                on_unsent=lambda error: self.fail(id, CallFailed(self.name, str(error))),
            )
        except BaseException:
            del self.pending[id]
            raise
        call.expiry = asyncio.get_running_loop().call_later(timeout_s, call.expire)
        return call

    def answered(self, op: ops.ServiceResponse) -> None:
        """Take an answer: a response, or a text (or nothing, with a false ``result``) that fails the call.

        A false ``result`` with a response counts for nothing, as with rosbridge: what a ROS 2 service has to say stands
        in its response. Raises ``InvalidOperation`` for an answer that nobody waits for, ``TypesError`` for a bad one.
        """
        call = self.pending.get(op.id) if isinstance(op.id, str) else None
        if call is None:
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
        call.end(payload)

    def fail(self, id: str, error: CallError) -> None:
        """Fail one call."""
        call = self.pending.get(id)
        if call is not None:
            call.end(error)

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
