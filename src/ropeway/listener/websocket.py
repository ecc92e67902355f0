"""Opening WebSocket connections: dialling and listening."""

from __future__ import annotations

import logging
import os
import socket
import ssl
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

import picows
from picows.url import WSParsedURL

from ropeway import aio
from ropeway.errors import ConnectFailed
from ropeway.fault_log import FaultLog
from ropeway.listener.connection import Connection, Limits
from ropeway.listener.http import HttpRequest, Response, reply, without_token
from ropeway.listener.http_upgrade import Admission, Admit, Http, HttpUpgrade, Port
from ropeway.listener.interface import dial_by
from ropeway.listener.listener import Listener, open_listener
from ropeway.listener.lobby import Lobby
from ropeway.logs import LoggerAdapter
from ropeway.types.untrusted import json_value

__all__ = ["connect", "listen"]


class _PicowsLog(LoggerAdapter):
    """Drops picows' errors: they are what a peer did wrong, which we log with its address. Its exceptions stay."""

    def error(self, msg: object, *args: object, **kwargs: Any) -> None:
        """Drop the line."""


logging.getLogger("ropeway.link.picows").setLevel(logging.ERROR)
_picows_log = _PicowsLog(logging.getLogger("ropeway.link.picows"), {})

_OTHER_HOST: Final = (62, 64)  # OpenSSL: X509_V_ERR_HOSTNAME_MISMATCH, X509_V_ERR_IP_ADDRESS_MISMATCH
_EXPIRED: Final = 10
_PLAIN: Final = ("WRONG_VERSION_NUMBER", "HTTP_REQUEST", "UNKNOWN_PROTOCOL", "PACKET_LENGTH_TOO_LONG")


async def connect(
    url: str,
    *,
    limits: Limits,
    subprotocols: Sequence[str] = (),
    ssl_context: ssl.SSLContext | None = None,
    headers: Mapping[str, str] | None = None,
    on_connection: Callable[[Connection], None] | None = None,
    interface: str = "",
) -> Connection:
    """Connect to a ``ws://`` or ``wss://`` URL, by a network interface where one is named.

    ``on_connection`` is called before the first message: what the server says at once is lost without.
    Raises ``ConnectFailed``; its ``retryable`` is false for answers that another try will not change.
    """
    shown = without_token(url)
    connection = Connection(limits, peer=shown)
    if on_connection is not None:
        connection.on_connected = lambda: on_connection(connection)
    extra = dict(headers or {})
    if subprotocols:
        extra["Sec-WebSocket-Protocol"] = ", ".join(subprotocols)
    try:
        async with aio.timeout(limits.open_timeout_s):
            await picows.ws_connect(
                lambda: connection,
                url,
                ssl_context=ssl_context,
                websocket_handshake_timeout=limits.open_timeout_s,
                max_frame_size=limits.max_message_bytes,
                extra_headers=extra,
                logger_name=_picows_log,
                disconnect_on_exception=False,
                enable_auto_pong=False,
                socket_factory=partial(_dial_by, interface) if interface else None,
                max_redirects=0,  # a token is for the host that was named, and only that host was to be reached
            )
    except TimeoutError:
        raise ConnectFailed(shown, "no answer in time") from None
    except ssl.SSLCertVerificationError as error:
        raise ConnectFailed(shown, _distrust(error), retryable=False) from None
    except picows.WSHandshakeError as error:
        if error.response is None:
            raise ConnectFailed(shown, f"is not a WebSocket server ({error})") from None
        status = int(error.response.status)
        said = f": {_redirects(error.response)}" if 300 <= status < 400 else _said(error)
        fatal = 300 <= status < 400 or status in (400, 401, 403, 404)
        raise ConnectFailed(shown, f"answered HTTP {status}{said}", retryable=not fatal) from None
    except picows.WSError as error:
        raise ConnectFailed(shown, f"is not a WebSocket server ({error})") from None
    except OSError as error:
        raise ConnectFailed(shown, _reason(error)) from None
    if connection.closed or not connection.writable:  # picows takes a server that hangs up for one that answers
        hint = "; does it speak wss:// (TLS)?"
        if ssl_context is not None or url.startswith("wss:"):
            hint = "; does it ask for a certificate that it trusts (tls.certificate)?"
        raise ConnectFailed(shown, f"closed the connection during the handshake{hint}")
    return connection


async def _dial_by(interface: str, url: WSParsedURL) -> socket.socket:
    return await dial_by(interface, url.host, url.port)


async def listen(
    host: str,
    port: int,
    on_connection: Callable[[Connection], None],
    *,
    limits: Limits,
    subprotocols: Sequence[str] = (),
    ssl_context: ssl.SSLContext | None = None,
    path: str = "/",
    reuse_port: bool = False,
    admit: Admit | None = None,
    http: Http | None = None,
    lobby: Lobby | None = None,
) -> Listener:
    """Listen for WebSocket clients on ``host:port``; ``port`` 0 takes a free one.

    Of the subprotocols that a client offers the first of ours is chosen; a client that offers none gets none.
    ``admit`` decides instead, for a request to become a WebSocket on ``path``; ``http`` answers all other requests
    (without it, with 404). Connections wait in ``lobby`` until that is decided. Raises ``ConnectFailed`` if the address
    cannot be bound.
    """

    def choose(request: HttpRequest) -> Admission:
        return Admission(next((name for name in subprotocols if name in request.subprotocols), ""))

    def admit_here(request: HttpRequest) -> Admission | Response:
        if request.path.rstrip("/") != path.rstrip("/"):
            return _nothing_here(request)
        return (admit or choose)(request)

    shared = Port(limits, admit_here, http or _nothing_here, on_connection, _picows_log, FaultLog("front"))
    return await open_listener(
        f"{'wss' if ssl_context else 'ws'}://{f'[{host}]' if ':' in host else host}:{port}",
        host,
        port,
        lambda visit: HttpUpgrade(shared, visit),
        lobby=Lobby() if lobby is None else lobby,
        handshake_s=limits.open_timeout_s,
        context=ssl_context,
        reuse_port=reuse_port,
    )


def _redirects(response: picows.WSUpgradeResponse) -> str:
    """Say where an answer points to, which may be a host that only we can reach."""
    target = str(response.headers.get("Location", "elsewhere"))
    shown = target if target.isprintable() and len(target) <= 200 else "elsewhere"
    return f"it points to {shown}, which is not followed; write the address that is meant"


def _said(error: picows.WSHandshakeError) -> str:
    """Return the reason in an answer that is not a WebSocket, as other gateways give it."""
    try:
        reason = json_value(error.raw_body or b"{}")["error"]
    except (ValueError, KeyError, TypeError):
        return ""
    return f": {reason}" if isinstance(reason, str) and reason.isprintable() and len(reason) <= 200 else ""


def _nothing_here(request: HttpRequest) -> Response:
    return reply(404, {"error": f"there is nothing at {request.path}"})


def _nothing() -> None:
    """Do nothing: nothing needs to be undone."""


def _distrust(error: ssl.SSLCertVerificationError) -> str:
    if error.verify_code in _OTHER_HOST:
        return f"its certificate is not for this host ({error.verify_message})"
    if error.verify_code == _EXPIRED:
        return "its certificate has expired"
    return f"its certificate is not trusted ({error.verify_message}); name its CA under tls.ca"


def _reason(error: OSError) -> str:
    """Return the operating system's message without the words of the event loop around it."""
    if isinstance(error, ssl.SSLError) and error.reason in _PLAIN:
        return "does not speak TLS; is it a ws:// server?"
    if isinstance(error, (socket.gaierror, ssl.SSLError)) or not error.errno:
        return error.strerror or str(error)
    return os.strerror(error.errno)
