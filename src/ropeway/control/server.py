"""Serves the control API with uvicorn's HTTP on the event loop of the gateway."""

from __future__ import annotations

import asyncio
import hashlib
import os
import socket
import ssl
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.config import Config as UvicornConfig
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from ropeway.control.admission import AnyAdmission
from ropeway.control.app import ABORT, PEER, make_app
from ropeway.control.caller import ControlPeer
from ropeway.control.resources.metrics import resources as metrics
from ropeway.limits import CONTROL_CONNECTIONS, CONTROL_HEAD_BYTES, CONTROL_REQUEST_S

if TYPE_CHECKING:
    from ropeway.control.manager import Manager

__all__ = ["ControlServer", "serve"]

_CREDENTIALS: Final = struct.Struct("3i")  # pid, uid, gid
_IDLE_S: Final = 30.0
_END_S: Final = 1.0
_UNREAD_BYTES: Final = 256 << 10


async def serve(
    manager: Manager,
    admission: AnyAdmission,
    bound: socket.socket,
    *,
    context: ssl.SSLContext | None = None,
    metrics_only: bool = False,
) -> ControlServer:
    """Answer for ``manager`` on a socket that listens; with ``metrics_only`` nothing but metrics."""
    server = ControlServer(make_app(manager, admission, only=metrics.listed if metrics_only else None))
    await server.listen(bound, context=context)
    return server


class ControlServer:
    """Answers on sockets that are bound already. ``app`` gets every connection's ``ControlPeer`` in its scope."""

    def __init__(self, app: ASGIApp, *, max_connections: int = CONTROL_CONNECTIONS) -> None:
        self.refused = 0  # connections above the limit
        self._config = UvicornConfig(
            app,
            http="h11",
            ws="none",
            lifespan="off",
            log_config=None,
            log_level="error",  # what a stranger sends is answered; it need not fill the log, too
            access_log=False,
            proxy_headers=False,
            server_header=False,
            date_header=False,
            timeout_keep_alive=round(_IDLE_S),
            h11_max_incomplete_event_size=CONTROL_HEAD_BYTES,
        )
        self._config.load()
        self._state = ServerState()
        self._max = max_connections
        self._servers: list[asyncio.Server] = []

    async def listen(self, bound: socket.socket, *, context: ssl.SSLContext | None = None) -> None:
        """Serve on a socket that listens."""
        loop = asyncio.get_running_loop()
        if bound.family == socket.AF_UNIX:
            self._servers.append(await loop.create_unix_server(self.connection, sock=bound))
        else:
            self._servers.append(await loop.create_server(self.connection, sock=bound, ssl=context))

    async def close(self) -> None:
        """Take no more requests, and end those that are under way."""
        for server in self._servers:
            server.close()
        for connection in list(self._state.connections):
            connection.shutdown()
        if self._state.tasks:
            await asyncio.wait(list(self._state.tasks), timeout=_END_S)
        for task in list(self._state.tasks):
            task.cancel()
        for connection in list(self._state.connections):
            if connection.transport is not None:
                connection.transport.abort()

    @property
    def connections(self) -> int:
        """The number of connections."""
        return len(self._state.connections)

    def connection(self) -> asyncio.Protocol:
        """Return the protocol of one more connection."""
        return _Connection(self._config, self._state, self)

    def full(self) -> bool:
        """Return whether there are more connections than there may be; count one that is refused."""
        if len(self._state.connections) <= self._max:
            return False
        self.refused += 1
        return True


class _Connection(H11Protocol):
    """A connection that says who is at its other end, and has to send the head of each request in time."""

    def __init__(self, config: UvicornConfig, state: ServerState, owner: ControlServer) -> None:
        super().__init__(config=config, server_state=state, app_state={})
        self._owner = owner
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """Learn who it is; close it where there are too many."""
        super().connection_made(transport)
        if self._owner.full():
            transport.abort()
            return
        transport.set_write_buffer_limits(high=_UNREAD_BYTES)
        self.app: Any = _WithPeer(self.app, _peer_of(transport), transport.abort)
        self._begin_deadline()

    def data_received(self, data: bytes) -> None:
        """Take bytes; a request that has begun has to come in time."""
        before = self.cycle
        if self._deadline is None and (before is None or before.response_complete):
            self._begin_deadline()
        super().data_received(data)
        if self.cycle is not before:
            self._end_deadline()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        super().connection_lost(exc)
        self._end_deadline()

    def _begin_deadline(self) -> None:
        self._deadline = asyncio.get_running_loop().call_later(CONTROL_REQUEST_S, self.transport.abort)

    def _end_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class _WithPeer:
    """The application as one connection sees it."""

    def __init__(self, app: ASGIApp, peer: ControlPeer, abort: Callable[[], None]) -> None:
        self._app, self._peer, self._abort = app, peer, abort

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        scope[PEER], scope[ABORT] = self._peer, self._abort
        await self._app(scope, receive, send)


def _peer_of(transport: asyncio.Transport) -> ControlPeer:
    """Return who is at the other end of a connection."""
    bound = transport.get_extra_info("socket")
    if bound.family == socket.AF_UNIX:
        pid, uid = _credentials(bound)
        return ControlPeer(f"unix:{pid}", uid=uid)
    address, local = transport.get_extra_info("peername"), transport.get_extra_info("sockname")
    tls = transport.get_extra_info("ssl_object")
    raw = tls.getpeercert(binary_form=True) if tls is not None else None
    return ControlPeer(
        f"{address[0]}:{address[1]}" if ":" not in address[0] else f"[{address[0]}]:{address[1]}",
        local=local[0],
        secure=tls is not None,
        certificate=tls.getpeercert() if tls is not None else None,
        fingerprint=hashlib.sha256(raw).hexdigest() if raw else "",
    )


def _credentials(bound: Any) -> tuple[int, int]:
    """Return the process and the user at the other end of a UNIX socket."""
    if not hasattr(socket, "SO_PEERCRED"):  # macOS; the mode of the socket keeps others out
        return 0, os.geteuid()
    with socket.socket(fileno=os.dup(bound.fileno())) as copy:
        pid, uid, _ = _CREDENTIALS.unpack(copy.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))
    return pid, uid
