"""Listening sockets: accept connections, speak TLS where it is asked for, and hand each connection to a protocol.

Connections are accepted here rather than by ``aiofastnet.create_server``: when the process is out of open files, that
of aiofastnet 1.2 calls a method that sockets do not have, stays subscribed to the socket, and spins with two tracebacks
a turn (``test_listener.py`` has a test that fails once this is mended there). Besides, a connection counts towards the
lobby from here on, during its TLS handshake, too.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import ssl
from collections.abc import Callable
from functools import partial
from typing import Any, Final

import aiofastnet

from ropeway.errors import ConnectFailed
from ropeway.fault_log import FaultLog
from ropeway.listener.handshakes import explain_handshake, watch_handshakes
from ropeway.listener.lobby import Lobby, Visit
from ropeway.tasks import Chores

__all__ = ["Listener", "keep_alive", "open_listener"]

MakeProtocol = Callable[[Visit], asyncio.BaseProtocol]

_BACKLOG: Final = 1024  # clients that come back all at once after a cut
_PER_TURN: Final = 16  # connections that are accepted before others have their turn
_PAUSE_S: Final = 1.0
_NO_ROOM: Final = frozenset((errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM))
_BIO_BYTES: Final = 17 << 10  # of a TLS connection each way: a record; the default is 256 KiB, also half-open
_SHUTDOWN_S: Final = 2.0  # how long a client may take to say goodbye
_ABSENT: Final = frozenset((errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT))


class Listener:
    """The sockets of one address, and the connections on which TLS is not spoken yet; made by ``open_listener``.

    ``context`` may be replaced at any time, for connections to come.
    """

    def __init__(
        self,
        sockets: list[socket.socket],
        address: str,
        make: MakeProtocol,
        lobby: Lobby,
        context: ssl.SSLContext | None,
        handshake_s: float,
        many: bool,
    ) -> None:
        self._many = many
        self.context, self.address = context, address
        self.port: int = sockets[0].getsockname()[1]
        self._make, self._lobby, self._handshake_s = make, lobby, handshake_s
        self._loop = asyncio.get_running_loop()
        self._fault_log = FaultLog(address)
        self._sockets = sockets
        self._greetings = Chores()
        self._accepted: dict[Visit, socket.socket] = {}  # whose greeting has not begun
        self._end_watching = (
            watch_handshakes(self._fault_log, self.port) if context is not None else contextlib.nullcontext
        )
        for sock in sockets:
            sock.setblocking(False)
            sock.listen(_BACKLOG)
            self._resume(sock)

    async def close(self) -> None:
        """Stop listening; connections that were let in go on. Harmless twice."""
        sockets, self._sockets = self._sockets, []
        for sock in sockets:
            self._loop.remove_reader(sock)
            sock.close()
        self._lobby.clear(self)
        await self._greetings.close()
        self._end_watching()

    def _resume(self, sock: socket.socket) -> None:
        if sock in self._sockets:
            self._loop.add_reader(sock, self._accept, sock)

    def _accept(self, sock: socket.socket) -> None:
        for _ in range(_PER_TURN):
            try:
                connection, peer = sock.accept()
            except (BlockingIOError, InterruptedError):
                return
            except ConnectionAbortedError:
                continue
            except OSError as error:
                if error.errno not in _NO_ROOM:
                    raise
                self._fault_log.note("accept", "", f"{error.strerror}; connections wait until there is room")
                self._loop.remove_reader(sock)
                self._loop.call_later(_PAUSE_S, self._resume, sock)
                self._lobby.relieve()
                return
            connection.setblocking(False)
            visit = self._lobby.enter(str(peer[0]), self, connection.close)
            self._accepted[visit] = connection
            task = self._greetings.start(self._greet(visit), "greeting of a client")
            visit.drop = task.cancel
            task.add_done_callback(partial(self._greeted, visit))

    def _greeted(self, visit: Visit, _: object) -> None:
        """Close a connection whose greeting was cancelled before its first step, or while it waited for its turn."""
        connection = self._accepted.pop(visit, None)
        if connection is not None:
            visit.leave()
            connection.close()

    async def _greet(self, visit: Visit) -> None:
        """Do the TLS handshake, and hand the connection over; from then on the visit is the protocol's."""
        if self.context is not None:
            async with self._lobby.turns.turn():
                await self._hand_over(visit)
        else:
            await self._hand_over(visit)

    async def _hand_over(self, visit: Visit) -> None:
        connection = self._accepted.pop(visit)
        timers = _Timers(self._loop)
        loop: Any = self._loop
        secure: dict[str, Any] = {}
        if self.context is not None:
            loop = timers
            secure = {
                "ssl": self.context,
                "ssl_handshake_timeout": self._handshake_s,
                "ssl_incoming_bio_size": _BIO_BYTES,
                "ssl_shutdown_timeout": _SHUTDOWN_S,
                "ssl_outgoing_bio_size": _BIO_BYTES,
            }
        try:
            if self._many and not secure:
                await loop.connect_accepted_socket(lambda: self._make(visit), connection)
            else:
                await aiofastnet.connect_accepted_socket(loop, lambda: self._make(visit), connection, **secure)
            timers.keep()
        except OSError as error:  # who has left by now needs nothing
            visit.leave()
            error.__traceback__ = None  # it and the handshake would keep each other
            if isinstance(error, ssl.SSLError):  # which aiofastnet tells nobody else
                self._fault_log.note("handshake", "", explain_handshake(error))
        except BaseException:
            visit.leave()
            timers.cancel()
            raise


class _Timers:
    """The event loop for one handshake, with the timers that it sets.

    A handshake that is given up leaves its timer running, and with it all that TLS needs for it (aiofastnet 1.2).
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._set: list[asyncio.TimerHandle] = []

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._loop, name)
        setattr(self, name, found)  # the next look finds it at once
        return found

    def call_later(self, delay: float, callback: Callable[..., object], *args: Any) -> asyncio.TimerHandle:
        """Set a timer."""
        timer = self._loop.call_later(delay, callback, *args)
        self._set.append(timer)
        return timer

    def keep(self) -> None:
        """Watch over no more timers: the handshake is done."""
        self._set.clear()
        setattr(self, "call_later", self._loop.call_later)  # noqa: B010 - in the place of the method

    def cancel(self) -> None:
        """Stop all timers that were set."""
        for timer in self._set:
            timer.cancel()
        self._set.clear()


async def open_listener(
    url: str,
    host: str,
    port: int,
    make: MakeProtocol,
    *,
    lobby: Lobby,
    handshake_s: float,
    context: ssl.SSLContext | None = None,
    reuse_port: bool = False,
    many: bool = False,
) -> Listener:
    """Listen on ``host:port``, every address of it; port 0 takes a free one. ``make`` makes the protocols.

    ``many``: there will be thousands of clients, each with little to say. Without TLS they get the transports of the
    event loop, which take 1.4 kB, where those that write large messages faster take 6.4.
    Raises ``ConnectFailed``, which names ``url``, if that cannot be had.
    """
    try:
        sockets = await _bind(host, port, reuse_port)
    except OSError as error:
        hint = "; is another gateway running?" if error.errno == errno.EADDRINUSE else ""
        text = f"cannot listen: {error.strerror or error}{hint}"
        raise ConnectFailed(url, text, retryable=False) from None
    return Listener(sockets, url, make, lobby, context, handshake_s, many)


async def _bind(host: str, port: int, reuse_port: bool) -> list[socket.socket]:
    """Return a socket for every address of the host that this machine has."""
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    absent: OSError | None = None
    with contextlib.ExitStack() as stack:
        sockets: list[socket.socket] = []
        for family, kind, protocol, _, address in dict.fromkeys(found):
            try:
                sock = stack.enter_context(socket.socket(family, kind, protocol))
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if reuse_port:
                    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
                if family == socket.AF_INET6:  # a socket of its own has the IPv4 address
                    sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                taken = sockets[0].getsockname()[1] if sockets else port
                sock.bind((address[0], taken, *address[2:]))
            except OSError as error:
                if error.errno not in _ABSENT:
                    raise
                absent = error
                continue
            sockets.append(sock)
        if not sockets:
            raise absent or OSError(f"{host} has no address")
        stack.pop_all()
    return sockets


def keep_alive(transport: asyncio.BaseTransport) -> None:
    """Make TCP probe clients that may be silent for hours, so that one that was switched off is noticed."""
    sock = transport.get_extra_info("socket")
    if sock is None or sock.family not in (socket.AF_INET, socket.AF_INET6):
        return
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in (("TCP_KEEPIDLE", 30), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, option):
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
