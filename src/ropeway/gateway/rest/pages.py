"""Hands requests for ``/ros/…`` at a rosbridge listener to uvicorn's HTTP, which reads their bodies.

A request was admitted before it comes here, so tokens, certificates, web pages and lockouts are those of the listener,
and so are the rights. Each connection carries one request.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, Final

from starlette.requests import ClientDisconnect
from uvicorn.config import Config as UvicornConfig
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from ropeway import aio
from ropeway.gateway.rest.app import ACCESS, RestApp
from ropeway.limits import REST_HEAD_BYTES, REST_READER_S, REST_REQUEST_S, REST_REQUESTS, REST_UNREAD_BYTES
from ropeway.listener.http import HttpRequest, Response, reply

if TYPE_CHECKING:
    from collections.abc import Callable

    from starlette.types import Receive, Scope, Send

    from ropeway.hub.hub import Hub
    from ropeway.listener.authorization import Access, Role
    from ropeway.types import TypeRegistry

__all__ = ["RestPages"]

_ROOT: Final = "/ros"
_END_S: Final = 1.0


class RestPages:
    """The resources of one graph.

    ``call_timeout_s`` is for calls that give no timeout, 0 for no limit; ``reader_s`` is for how long a client may take
    nothing of its answer.
    """

    cross_origin_methods: tuple[str, ...] = ("GET", "POST")

    def __init__(
        self,
        hub: Hub,
        registry: TypeRegistry,
        *,
        unregister_timeout_s: float,
        call_timeout_s: float,
        reader_s: float = REST_READER_S,
    ) -> None:
        self._app = RestApp(hub, registry, unregister_timeout_s=unregister_timeout_s, call_timeout_s=call_timeout_s)
        self._config = UvicornConfig(
            self._app,
            http="h11",
            ws="none",
            lifespan="off",
            log_config=None,
            access_log=False,
            proxy_headers=False,
            server_header=False,
            date_header=False,
            h11_max_incomplete_event_size=REST_HEAD_BYTES,
        )
        self._config.load()
        self._state = ServerState()
        self._reader_s = reader_s
        self._connections: dict[_RestConnection, tuple[HttpRequest, Role]] = {}

    @property
    def connections(self) -> int:
        """The number of requests that are under way."""
        return len(self._connections)

    def knows(self, path: str) -> bool:
        """Return whether ``path`` is one of its paths."""
        return path == _ROOT or path.startswith(f"{_ROOT}/")

    def __call__(self, request: HttpRequest, access: Access) -> Response | asyncio.Protocol:
        """Return the protocol that goes on with the connection, or the answer where there are too many."""
        if len(self._connections) >= REST_REQUESTS:
            return reply(503, {"error": f"{REST_REQUESTS} requests are under way; try again"}, Retry_After="1")
        connection = _RestConnection(self._config, self._state, access, self._connections, self._reader_s)
        self._connections[connection] = (request, access.role)
        return connection

    def recheck(self, keeps: Callable[[HttpRequest, Role], bool]) -> None:
        """End the requests of clients that would no longer come in with the same role."""
        for connection, (request, role) in list(self._connections.items()):
            if not keeps(request, role):
                connection.transport.abort()

    async def close(self) -> None:
        """End all requests, and withdraw what was made for them."""
        for connection in list(self._connections):
            if connection.transport is not None:
                connection.transport.abort()
        if self._state.tasks:
            await asyncio.wait(list(self._state.tasks), timeout=_END_S)
        await self._app.close()


class _RestConnection(H11Protocol):
    """A connection with one request, which has to come whole in time."""

    def __init__(
        self,
        config: UvicornConfig,
        state: ServerState,
        access: Access,
        connections: dict[_RestConnection, tuple[HttpRequest, Role]],
        reader_s: float,
    ) -> None:
        super().__init__(config=config, server_state=state, app_state={})
        self._access, self._connections, self._reader_s = access, connections, reader_s
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """Begin to read the request."""
        super().connection_made(transport)
        transport.set_write_buffer_limits(high=REST_UNREAD_BYTES)
        inner = self.app
        access, end, reader_s = self._access, self._end_deadline, self._reader_s

        async def app(scope: Scope, receive: Receive, send: Send) -> None:
            scope[ACCESS] = access
            await inner(scope, _until_read(receive, end), _timely(send, reader_s, transport.abort))

        self.app: Any = app
        self._deadline = asyncio.get_running_loop().call_later(REST_REQUEST_S, transport.abort)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._end_deadline()
        self._connections.pop(self, None)
        super().connection_lost(exc)

    def _end_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


def _until_read(receive: Receive, read: Callable[[], None]) -> Receive:
    """Return the same as ``receive``, which calls ``read`` once the whole body has come."""

    async def watched() -> Any:
        message = await receive()
        if not message.get("more_body", False):
            read()
        return message

    return watched


def _timely(send: Send, reader_s: float, abort: Callable[[], None]) -> Send:
    """Return the same as ``send``, which ends the connection of a client that takes nothing for too long."""

    async def timely(message: Any) -> None:
        try:
            async with aio.timeout(reader_s):
                await send(message)
        except TimeoutError:
            abort()
            raise ClientDisconnect from None

    return timely
