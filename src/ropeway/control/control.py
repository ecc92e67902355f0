"""The control API of a running gateway: its sockets, its server and its manager, as one thing to enter and leave."""

from __future__ import annotations

import logging
import socket
import ssl
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from ropeway.control.admission import AnyAdmission, TcpAdmission, UnixAdmission
from ropeway.control.changes import StateChanges, states_of
from ropeway.control.claim import SocketClaim
from ropeway.control.on_demand import ClosableServer, ServedOnDemand
from ropeway.control.place import own_directory, socket_path
from ropeway.errors import ConnectFailed, ControlError, NameTaken
from ropeway.gateway.auth import make_door
from ropeway.gateway.config.control_model import ControlConfig
from ropeway.gateway.tls import server_context
from ropeway.loading import load
from ropeway.tasks import Supervised

if TYPE_CHECKING:
    from ropeway.control.manager import Manager

__all__ = ["Control"]

log = logging.getLogger("ropeway.control")

_MOST_OF_A_NAME: Final = 100
_BACKLOG: Final = 64
_SERVER: Final = "ropeway.control.server"
"""The module that answers HTTP: 7 MB and 0.2 s that gateways without a caller do not need."""


class Control:
    """Serves the control API of ``manager`` while it is entered.

    A name that another gateway has is an error only where the configuration asks for it; else a number is put behind
    it. What goes wrong with a socket that nobody asked for is a warning: data flows without.
    """

    def __init__(self, manager: Manager) -> None:
        self.manager = manager
        self.name = ""
        self.addresses: list[str] = []  # over TCP
        self.metrics_addresses: list[str] = []  # those that have metrics alone
        self._admission: TcpAdmission | None = None
        self._stack = AsyncExitStack()

    def status(self) -> dict[str, Any]:
        """Return where the API is, and who was refused over TCP, as JSON."""
        refused = {} if self._admission is None else self._admission.entrance.status()
        return {"name": self.name, "listen": self.addresses, "metrics": self.metrics_addresses, **refused}

    async def __aenter__(self) -> Control:
        """Begin to serve. Raises ``ControlError`` or ``ConnectFailed`` where what was asked for cannot be had."""
        async with AsyncExitStack() as stack:
            await self._bring_up(stack)
            self._stack = stack.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        """End it."""
        await self._stack.aclose()

    async def _bring_up(self, stack: AsyncExitStack) -> None:
        settings = self.manager.config.gateway
        control = settings.control
        if not control.enabled:
            return
        try:
            claim = self._claim(control.name or settings.name, asked=control.name is not None)
        except ControlError as error:
            if control != ControlConfig.model_validate({}):
                raise
            log.warning('%s; nobody can see or change this gateway ("control": false says that is meant)', error)
            return
        stack.callback(claim.close)
        self._serve(stack, UnixAdmission(self.manager.audit), claim.socket)
        if control.listen or control.metrics:
            admission = self._admission = TcpAdmission(make_door(settings), self.manager.audit)
            self.manager.on_door(admission.renew)
            for url in control.listen:
                self.addresses.append(await self._listen(stack, admission, url))
            for url in control.metrics:
                self.metrics_addresses.append(await self._listen(stack, admission, url, metrics_only=True))
        states = StateChanges(lambda: states_of(self.manager.running), self.manager.events.tell)
        stack.push_async_callback(Supervised(states.run, "changes of state").start().close)
        log.info("ropeway status %s shows this gateway (%s)", self.name, claim.path)

    async def _listen(
        self, stack: AsyncExitStack, admission: AnyAdmission, url: str, *, metrics_only: bool = False
    ) -> str:
        """Serve at an address over TCP; return it with the port that it has."""
        bound = _bind(url)
        stack.callback(bound.close)
        context = server_context(self.manager.config.gateway.tls) if url.startswith("https:") else None
        self._serve(stack, admission, bound, context, metrics_only=metrics_only)
        host, port = bound.getsockname()[:2]
        return f"{url.partition(':')[0]}://{f'[{host}]' if ':' in host else host}:{port}"

    def _serve(
        self,
        stack: AsyncExitStack,
        admission: AnyAdmission,
        bound: socket.socket,
        context: ssl.SSLContext | None = None,
        *,
        metrics_only: bool = False,
    ) -> None:
        async def begin() -> ClosableServer:
            server = await load(_SERVER)
            made: ClosableServer = await server.serve(
                self.manager, admission, bound, context=context, metrics_only=metrics_only
            )
            return made

        stack.push_async_callback(ServedOnDemand(bound, begin).close)

    def _claim(self, name: str, *, asked: bool) -> SocketClaim:
        directory = own_directory()
        number = 1
        while True:
            self.name = name if number == 1 else f"{name}-{number}"
            try:
                return SocketClaim(socket_path(directory, self.name))
            except NameTaken:
                if asked or number == _MOST_OF_A_NAME:
                    raise
            number += 1


def _bind(url: str) -> socket.socket:
    """Return a socket that listens at an address over TCP. Raises ``ConnectFailed``."""
    parts = urlsplit(url)
    host, port = parts.hostname or "", parts.port or 0
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        bound = socket.socket(family, kind, protocol)
        try:
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.setblocking(False)
            bound.bind(address)
            bound.listen(_BACKLOG)
        except OSError:
            bound.close()
            raise
    except OSError as error:
        raise ConnectFailed(url, f"cannot listen: {error.strerror or error}", retryable=False) from None
    return bound
