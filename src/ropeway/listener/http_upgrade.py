"""The front of a listening port: reads the head of a request, and decides who goes on with the connection.

A request to become a WebSocket goes to picows, once it is admitted; every other request is answered here, or goes to
another protocol that ``http`` names. Until then nothing of a client is trusted: what it sends is bounded in bytes,
and so is the time that it takes.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import hashlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, cast

from picows import WSAutoPingStrategy, WSUpgradeRequest, WSUpgradeResponse, WSUpgradeResponseWithListener
from picows.picows import WSProtocol  # type: ignore[attr-defined]  # in no stub, but api.py of picows makes it so

from ropeway.errors import InvalidFrame
from ropeway.fault_log import FaultLog
from ropeway.listener.connection import Connection, Limits, peer_address
from ropeway.listener.http import MAX_HEAD_BYTES, HttpRequest, Response, parse_head, reply
from ropeway.listener.lobby import Visit

__all__ = ["Admission", "Admit", "Http", "HttpUpgrade", "Port", "identified"]

log = logging.getLogger("ropeway.link")

_READ_BYTES: Final = 4096
_LINGER_S: Final = 1.0  # how long a client may take to read its answer
_END: Final = b"\r\n\r\n"
_TLS_HELLO: Final = b"\x16\x03"  # a TLS record with the beginning of a handshake, of any version


@dataclass(frozen=True, slots=True)
class Admission:
    """A WebSocket client may come in.

    ``subprotocol`` is what it is told, ``""`` for none; ``limits`` are those of its connection, ``None`` for the
    port's; ``grant`` is kept in ``Connection.grant`` for whoever admitted it.
    """

    subprotocol: str = ""
    limits: Limits | None = None
    grant: object = None


Admit = Callable[[HttpRequest], Admission | Response]
"""Decides on a request to become a WebSocket: an answer other than an ``Admission`` refuses it."""

Http = Callable[[HttpRequest], Response | asyncio.Protocol]
"""Answers every other request. A protocol is handed the connection, with ``HttpRequest.head`` as its first data."""


@dataclass(frozen=True, slots=True, eq=False)
class Port:
    """Holds what all connections of a listening port share."""

    limits: Limits
    admit: Admit
    http: Http
    on_connection: Callable[[Connection], None]
    logger: Any
    fault_log: FaultLog


class HttpUpgrade(asyncio.BufferedProtocol):
    """The first protocol of an incoming connection; see the module."""

    def __init__(self, port: Port, visit: Visit) -> None:
        self._port, self._visit = port, visit
        self._head = bytearray()
        self._buffer = bytearray(_READ_BYTES)
        self._transport: asyncio.Transport | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._answered = False

    # ── what the event loop calls ──────────────────────────────────────────────────────────────────────────────

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a new client's connection."""
        self._transport = cast(asyncio.Transport, transport)  # uvloop's own are none
        self._visit.drop = self.abort
        loop = asyncio.get_running_loop()
        self._timer = loop.call_later(self._port.limits.open_timeout_s, self._late)

    def get_buffer(self, sizehint: int) -> bytearray:
        """Return the buffer for incoming data."""
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Take bytes that have arrived."""
        if self._answered:
            return
        begin = max(len(self._head) - len(_END) + 1, 0)
        self._head += memoryview(self._buffer)[:nbytes]
        end = self._head.find(_END, begin)
        if end >= 0 and end + len(_END) <= MAX_HEAD_BYTES:
            self._complete(end + len(_END))
        elif self._head.startswith(_TLS_HELLO):
            self._speaks_tls()
        elif len(self._head) > MAX_HEAD_BYTES:
            self._answer(reply(431, {"error": f"the head of a request has {MAX_HEAD_BYTES} bytes at most"}))

    def eof_received(self) -> bool:
        """Close the connection when the client has sent everything."""
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget a connection that has ended."""
        self._forget()

    # ── deciding ───────────────────────────────────────────────────────────────────────────────────────────────

    def abort(self) -> None:
        """Drop the connection."""
        self._forget()
        if self._transport is not None:
            self._transport.abort()

    def _late(self) -> None:
        if self._answered:
            self.abort()
        else:
            self._answer(reply(408, {"error": "the request did not come in time"}))

    def _forget(self) -> None:
        self._visit.leave()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _complete(self, size: int) -> None:
        transport = self._transport
        assert transport is not None
        head, rest = bytes(self._head[:size]), bytes(self._head[size:])
        try:
            request = identified(parse_head(head), transport)
        except InvalidFrame as error:
            self._answer(reply(400, {"error": str(error)}))
            return
        body = request.method != "HEAD"
        try:
            made = self._websocket(request) if request.upgrades else self._port.http(request)
        except Exception:  # of a page or of ours: the connection gets an answer in any case
            log.exception("%s: the answer to %s %s failed", request.peer, request.method, request.path)
            made = reply(500, {"error": "internal error"})
        if isinstance(made, Response):
            self._answer(made, body=body)
        else:
            self._hand_over(made, (_upgrade_head(request) if isinstance(made, WSProtocol) else head) + rest)

    def _speaks_tls(self) -> None:
        """Tell both sides why this cannot be: an answer in clear makes the client give up at once."""
        assert self._transport is not None
        peer = peer_address(self._transport.get_extra_info("peername"))
        self._port.fault_log.note("handshake", "", f"{peer} speaks TLS (wss://), and this listener ws://")
        self._answer(reply(400, {"error": "ws:// is spoken here, without TLS"}))

    def _websocket(self, request: HttpRequest) -> Response | Any:
        if request.method != "GET":
            return reply(405, {"error": "a WebSocket begins with GET"}, Allow="GET")
        if request.headers.get("sec-websocket-version") != "13":
            return reply(426, {"error": "WebSocket version 13 is spoken here"}, Sec_WebSocket_Version="13")
        if not _is_key(request.headers.get("sec-websocket-key", "")):
            return reply(400, {"error": "the Sec-WebSocket-Key is not 16 bytes in base64"})
        admission = self._port.admit(request)
        if isinstance(admission, Response):
            return admission
        limits = admission.limits or self._port.limits
        connection = Connection(limits)
        connection.subprotocol, connection.grant = admission.subprotocol, admission.grant
        connection.handshake = replace(request, head=b"")
        connection.on_connected = lambda: self._port.on_connection(connection)
        extra = {"Sec-WebSocket-Protocol": admission.subprotocol} if admission.subprotocol else None
        response = WSUpgradeResponse.create_101_response(extra_headers=extra)

        def upgrade(_: WSUpgradeRequest) -> Any:
            return WSUpgradeResponseWithListener(response, connection)

        return _picows(upgrade, limits, self._port.logger)

    def _hand_over(self, protocol: Any, data: bytes) -> None:
        """Hand the connection to another protocol, as if the client had just connected and sent ``data``."""
        transport = self._transport
        assert transport is not None
        self._forget()
        self._answered = True
        buffered = isinstance(protocol, asyncio.BufferedProtocol)
        if not buffered:
            transport.pause_reading()  # or the event loop would go on reading as it does for a buffered one
        transport.set_protocol(protocol)
        protocol.connection_made(transport)
        if not buffered:
            transport.resume_reading()
            protocol.data_received(data)
            return
        while data and not transport.is_closing():
            space = protocol.get_buffer(len(data))
            size = min(len(space), len(data))
            space[:size] = data[:size]
            protocol.buffer_updated(size)
            data = data[size:]

    def _answer(self, response: Response, *, body: bool = True) -> None:
        """Send the answer, then take and forget what still comes, so that the client can read it, and close."""
        transport = self._transport
        assert transport is not None
        self._answered = True
        self._head.clear()
        if self._timer is not None:
            self._timer.cancel()
        if response.delay_s:
            later = replace(response, delay_s=0.0)
            loop = asyncio.get_running_loop()
            self._timer = loop.call_later(response.delay_s, lambda: self._answer(later, body=body))
            return
        if transport.is_closing():
            return
        transport.write(response.encode(body=body))
        if transport.can_write_eof():
            transport.write_eof()
            self._timer = asyncio.get_running_loop().call_later(_LINGER_S, self._late)
        else:
            transport.close()


def _picows(upgrade: Callable[[WSUpgradeRequest], Any], limits: Limits, logger: Any) -> Any:
    """Make the protocol that ``picows.ws_create_server`` makes, with a size limit of this connection's own."""
    return WSProtocol(
        None,  # host and port, of a client
        None,  # path, of a client
        False,  # is_client_side
        upgrade,
        logger,
        False,  # disconnect_on_exception
        limits.open_timeout_s,
        False,  # enable_auto_ping
        20.0,  # auto_ping_idle_timeout
        20.0,  # auto_ping_reply_timeout
        WSAutoPingStrategy.PING_WHEN_IDLE,
        False,  # enable_auto_pong
        limits.max_message_bytes,
        None,  # extra_headers, of a client
        16 << 10,  # read_buffer_init_size
    )


def _upgrade_head(request: HttpRequest) -> bytes:
    """Return the part of the request that picows has to see; it accepts only one word under Connection, and Firefox
    sends two.
    """
    key = request.headers["sec-websocket-key"]
    return (
        "GET / HTTP/1.1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
        f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {key}\r\n\r\n"
    ).encode("ascii")


def _is_key(text: str) -> bool:
    try:
        return len(base64.b64decode(text.encode("ascii"), validate=True)) == 16
    except (UnicodeEncodeError, binascii.Error):
        return False


def identified(request: HttpRequest, transport: asyncio.Transport) -> HttpRequest:
    """Return the request with both addresses of its connection and, behind TLS, the certificate of who sent it."""
    peer = peer_address(transport.get_extra_info("peername"))
    name = transport.get_extra_info("sockname")
    request = replace(request, peer=peer, local=str(name[0]) if isinstance(name, tuple) else "")
    tls = transport.get_extra_info("ssl_object")
    if tls is None:
        return request
    raw = tls.getpeercert(binary_form=True)
    fingerprint = hashlib.sha256(raw).hexdigest() if raw else ""
    return replace(request, secure=True, certificate=tls.getpeercert() or None, fingerprint=fingerprint)
