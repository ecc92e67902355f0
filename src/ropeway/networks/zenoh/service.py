"""A service that we serve: a queryable of Zenoh's that answers whoever asks, whatever hash they know its type by."""

from __future__ import annotations

import asyncio
import hashlib
import logging
import time
from functools import partial
from typing import Any, Final, NamedTuple

import zenoh

from ropeway.errors import CallError, TypesError
from ropeway.graph.base import Undelivered
from ropeway.graph.calls import Request, ServiceHandler
from ropeway.graph.inlet import Inlet
from ropeway.limits import ZENOH_REQUESTS, ZENOH_REQUESTS_BYTES
from ropeway.logs import failed
from ropeway.networks.zenoh.attachment import Attachment, pack, parse
from ropeway.networks.zenoh.calls import REQUEST, RESPONSE, SERVICE_QOS, ZenohCallHost
from ropeway.networks.zenoh.sender import ZenohLane
from ropeway.networks.zenoh.session import ZenohPresence
from ropeway.tasks import Chores

__all__ = ["ZenohService"]

log = logging.getLogger("ropeway.zenoh")

_SHORTEST_BYTES: Final = 4
_TEXTS: Final = (("success", "message"), ("successful", "reason"))


class _Asked(NamedTuple):
    """A request: the query, its key and hash, and what it carries."""

    query: Any
    key: str
    payload: bytes
    attachment: Attachment


class ZenohService:
    """Serves ``service`` with ``handler``, each request in a task of its own.

    ROS 2 has no errors of services: a request of a node that fails is answered with the default response, in which
    ``message`` or ``reason`` says why where the type has them beside ``success`` or ``successful``. Another Ropeway is
    told the error as such.
    """

    def __init__(self, graph: ZenohCallHost, service: str, type: str, handler: ServiceHandler, type_hash: str) -> None:
        self.service, self.type = service, type
        self.closed = False
        self._graph, self._handler = graph, handler
        self._session = session = graph.session
        self._serving = Chores()
        self._lane = ZenohLane(self._unsent)
        self._lost = 0
        self._inlet: Inlet[_Asked | None] = Inlet(
            asyncio.get_running_loop(), self._on_requests, limit_bytes=ZENOH_REQUESTS_BYTES, on_lost=_let_go
        )
        handler_: Any = zenoh.handlers.Callback(self._take, indirect=False)
        self._raw: Any = session.attempt(
            lambda: session.raw.declare_queryable(
                session.key(service, type, "*"), handler_, complete=True, allowed_origin=zenoh.Locality.REMOTE
            )
        )
        self._presence = ZenohPresence(session, "server", service, type, type_hash, SERVICE_QOS)

    def follow(self) -> None:
        """See who calls it, and under which hashes."""
        self._presence.follow(self._graph.discovery.hashes("client", self.service, self.type))

    def _take(self, query: zenoh.Query) -> None:
        """Take a request, in a thread of Zenoh's."""
        raw, body = query.attachment, query.payload
        attachment = None if raw is None else parse(bytes(raw))
        payload = b"" if body is None else bytes(body)
        if attachment is None or len(payload) < _SHORTEST_BYTES:
            query.reply_err(b"this is no request of ROS 2: it lacks the CDR or the attachment")
            _end(query)
            self._inlet.put(None)
            return
        self._inlet.put(_Asked(query, str(query.key_expr), payload, attachment), len(payload))

    # On the loop ------------------------------------------------------------------------------------------------

    def _on_requests(self, batch: list[_Asked | None]) -> None:
        lost, self._lost = self._inlet.lost - self._lost, self._inlet.lost
        self._count(Undelivered.BACKLOG, lost)
        for asked in batch:
            if asked is None:
                self._count(Undelivered.DECODE, 1)
            elif len(self._serving.tasks) >= ZENOH_REQUESTS:
                self._count(Undelivered.BACKLOG, 1)
                self._fail(asked, f"{ZENOH_REQUESTS} requests of {self.service} are under way, which is the limit")
            else:
                self._serving.start(self._serve(asked), f"serve {self.service}")

    async def _serve(self, asked: _Asked) -> None:
        layouts, type_hash = self._graph.layouts, asked.key.rpartition("/")[2]
        identity = self._graph.discovery.identities.get(asked.attachment.gid)
        answered = False
        reason = Undelivered.DECODE
        try:
            payload = layouts.read(self.type, asked.payload, type_hash, part=REQUEST)
            request = Request(payload, _call_id(asked.attachment), (), identity.node if identity is not None else "")
            response = bytes(await self._handler(request))
            reason = Undelivered.ENCODE
            if len(response) < _SHORTEST_BYTES:
                self._count(Undelivered.ENCODE, 1)
                self._fail(asked, f"a response of {len(response)} bytes is not CDR")
            else:
                self._reply(asked, layouts.write(self.type, response, type_hash, part=RESPONSE))
            answered = True
        except CallError as error:
            self._fail(asked, str(error))
            answered = True
        except TypesError as error:
            self._count(reason, 1)
            self._fail(asked, str(error))
            answered = True
        except Exception as error:  # a handler is somebody else's code; its failure is this call's
            self._count(Undelivered.CALLBACK, 1)
            failed(log, "%s: the handler of %s failed", self._graph.name, self.service)
            self._fail(asked, str(error) or type(error).__name__)
            answered = True
        finally:
            if not answered:  # it was cancelled: who asked learns it from the end of the query
                _end(asked.query)

    def _fail(self, asked: _Asked, text: str) -> None:
        """Answer a Ropeway with an error, and a node with the default response."""
        identity = self._graph.discovery.identities.get(asked.attachment.gid)
        if identity is not None and identity.ours:
            self._send(asked, partial(asked.query.reply_err, text.encode()), len(text))
            return
        log.warning("%s: %s: answered with an empty response: %s", self._graph.name, self.service, text)
        try:
            codec = self._graph.registry.codec(f"{self.type}{RESPONSE}")
            response = codec.default()
            for flag, message in _TEXTS:
                if response.get(flag) is False and response.get(message) == "":
                    response[message] = text
            type_hash = asked.key.rpartition("/")[2]
            default = self._graph.layouts.write(self.type, codec.encode(response), type_hash, part=RESPONSE)
        except TypesError:
            self._count(Undelivered.ENCODE, 1)
            _end(asked.query)
            return
        self._reply(asked, default)

    def _reply(self, asked: _Asked, payload: bytes) -> None:
        number, _, gid = asked.attachment
        attachment = pack(number, time.time_ns(), gid)
        self._send(asked, partial(asked.query.reply, asked.key, payload, attachment=attachment), len(payload))

    def _send(self, asked: _Asked, reply: Any, size: int) -> None:
        def put() -> None:
            try:
                reply()
            finally:
                _end(asked.query)

        self._graph.sender.send(self._lane, put, size)

    def _count(self, reason: Undelivered, count: int) -> None:
        if count:
            self._graph.drops[self.service, reason] += count

    def _unsent(self, count: int) -> None:
        self._count(Undelivered.WRITE, count)

    async def close(self) -> None:
        """See ``Service``: requests that are not answered end without an answer."""
        if self.closed:
            return
        self.closed = True
        self._inlet.closed = True
        self._graph.forget(self)
        self._presence.close()
        await self._serving.close()
        await self._graph.sender.finish(self._lane)
        self._session.undeclare(self._raw)


def _let_go(asked: _Asked | None) -> None:
    if asked is not None:
        _end(asked.query)


def _end(query: Any) -> None:
    """Tell who asked that no more answers come."""
    query.drop()


def _call_id(attachment: Attachment) -> bytes:
    """Derive the id of a call: the same for every gateway, so that a call that two gateways take runs once behind
    them.
    """
    number = attachment.number.to_bytes(8, "little")
    return hashlib.blake2b(attachment.gid + number, digest_size=16).digest()
