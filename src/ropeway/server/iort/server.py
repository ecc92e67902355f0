"""Listens for IoRT nodes: thousands of connections on one event loop, each with a session."""

from __future__ import annotations

import asyncio
import itertools
import logging
import socket
import ssl
import time
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, Final
from urllib.parse import urlsplit

from ropeway.errors import ConnectFailed
from ropeway.graph.iort.space import Space
from ropeway.iort import DEFAULT_PORT, MAX_PACKET_BYTES, NodeError
from ropeway.link.connection import peer_address
from ropeway.link.front import identified
from ropeway.link.http import Request
from ropeway.server.access import Access, Role
from ropeway.server.door import Door
from ropeway.server.iort.session import Session
from ropeway.store import Entry
from ropeway.tasks import Chores, Supervised, end

__all__ = ["IortServer"]

log = logging.getLogger("ropeway.server.iort")

_TICK_S: Final = 1.0
_UNFINISHED_S: Final = 30.0
_SILENCE_S: Final = 30.0
_MAX_CLIENTS: Final = 10_000
_HANDSHAKE_S: Final = 10.0
_SHOWN_NODES: Final = 100  # of thousands, in a status that is printed every second


class IortServer:
    """Serves a space to nodes; ``door`` decides who may do what.

    ``max_packet_bytes`` bounds one packet. A node has ``unfinished_s`` for each of its packets, and one that speaks
    the upgrade is given up after ``silence_s`` without a word. ``render`` makes
    text of messages of ROS, which nodes cannot read; it raises ``NodeError`` or ``TypesError`` where it cannot.
    ``kinds`` says by their identifiers which plain nodes are a ``robot`` or a ``pc``; others tell it themselves.
    """

    def __init__(
        self,
        space: Space,
        *,
        door: Door | None = None,
        max_packet_bytes: int = MAX_PACKET_BYTES,
        max_clients: int = _MAX_CLIENTS,
        unfinished_s: float = _UNFINISHED_S,
        silence_s: float = _SILENCE_S,
        render: Callable[[Entry], bytes] | None = None,
        kinds: Mapping[str, str] | None = None,
    ) -> None:
        self.space, self.door = space, door or Door()
        self.max_packet_bytes, self.max_clients = max_packet_bytes, max_clients
        self.unfinished_s, self.silence_s = unfinished_s, silence_s
        self.render = render or _no_text
        self.kinds = dict(kinds or {})
        self.sessions: dict[Session, None] = {}
        self.counts: Counter[str] = Counter()
        self.denied: Counter[str] = Counter()
        self.addresses: list[tuple[str, int]] = []
        self._servers: list[asyncio.Server] = []
        self._tasks = Chores()
        self._ticker: Supervised | None = None
        self._names: Counter[str] = Counter()
        self._closing = False

    async def listen(self, url: str, *, ssl_context: ssl.SSLContext | None = None, reuse_port: bool = False) -> int:
        """Listen on ``iort://host:port`` or ``iorts://host:port``; the port is returned. Raises ``ConnectFailed``."""
        parts = urlsplit(url)
        if parts.scheme == "iorts" and ssl_context is None:
            raise ConnectFailed(url, "iorts needs a certificate and a key", retryable=False)
        host, port = parts.hostname or "127.0.0.1", DEFAULT_PORT if parts.port is None else parts.port
        loop = asyncio.get_running_loop()
        secure = ssl_context if parts.scheme == "iorts" else None
        try:
            server = await loop.create_server(
                lambda: Session(self),
                host,
                port,
                ssl=secure,
                ssl_handshake_timeout=_HANDSHAKE_S if secure is not None else None,
                backlog=1024,
                reuse_port=reuse_port or None,
            )
        except OSError as error:
            raise ConnectFailed(url, f"cannot be listened on: {error.strerror or error}", retryable=False) from error
        bound: int = server.sockets[0].getsockname()[1]
        self._servers.append(server)
        self.addresses.append((f"{parts.scheme}://{host}", bound))
        if self._ticker is None:
            self._ticker = Supervised(self._tick, "iort server ticks").start()
        log.info("listening on %s://%s:%d", parts.scheme, host, bound)
        return bound

    async def close(self) -> None:
        """Stop listening, and end every session."""
        self._closing = True
        for server in self._servers:
            server.close()
        for session in list(self.sessions):
            session.close("closed", "the server stops")
        await end(self._ticker)
        await self._tasks.close()
        self._ticker = None
        for server in self._servers:
            await server.wait_closed()
        self._servers.clear()
        self.addresses.clear()

    def status(self) -> dict[str, Any]:
        """How it stands, as JSON."""
        return {
            "listen": [{"address": address, "port": port} for address, port in self.addresses],
            "nodes": len(self.sessions),
            "upgraded": sum(session.upgraded for session in self.sessions),
            "kinds": dict(Counter(session.kind or "unknown" for session in self.sessions)),
            "connected": [
                {
                    "node": session.node,
                    "peer": session.peer,
                    "identifier": session.identifier,
                    "kind": session.kind,
                    "upgraded": session.upgraded,
                }
                for session in itertools.islice(self.sessions, _SHOWN_NODES)
            ],
            "counts": {what: n for what, n in sorted(self.counts.items()) if n},
            "denied": dict(self.denied),
        }

    def spawn(self, work: Coroutine[Any, Any, None]) -> None:
        """A task that ends with the server."""
        self._tasks.start(work, "request of a node")

    # ── what sessions call ─────────────────────────────────────────────────────────────────────────────────────

    def welcome(self, session: Session, transport: asyncio.Transport) -> bool:
        """A node connected; false where there is no place for it."""
        session.peer = peer_address(transport.get_extra_info("peername"))
        if self._closing or len(self.sessions) >= self.max_clients:
            self.counts["no place"] += 1
            return False
        _keep_alive(transport.get_extra_info("socket"))
        session.node = session.peer
        self.sessions[session] = None
        session.access = self._access(session, transport, None)
        self.space.join(session)
        self.counts["connections"] += 1
        return True

    def gone(self, session: Session) -> None:
        """A node is gone."""
        if session in self.sessions:
            del self.sessions[session]
            self.space.leave(session)
            self._names[session.node] -= 1
            if self._names[session.node] <= 0:
                del self._names[session.node]

    def hello(self, session: Session, name: str, token: str | None) -> str:
        """A node says who it is; what it should know is returned. Raises ``NodeError`` if it may not come in."""
        transport = session.transport
        assert transport is not None
        if len(name) > 200 or not name.isprintable():
            raise NodeError("name", "the name of a node is short and can be printed")
        access = self._access(session, transport, token)
        if access is None:
            raise NodeError("login", "a known token or certificate is needed")
        session.access = access
        self._names[session.node] -= 1
        if self._names[session.node] <= 0:
            del self._names[session.node]
        session.node = name
        self._names[name] += 1
        if self._names[name] > 1:
            self.counts["two of one name"] += 1
            log.warning("%s: another node is named %s, too; both are served", session.peer, name)
            return f"another node is named {name}, too"
        return ""

    def _access(self, session: Session, transport: asyncio.Transport, token: str | None) -> Access | None:
        headers = {} if token is None else {"authorization": f"Bearer {token}"}
        request = identified(Request("GET", "/", "HTTP/1.1", headers), transport)
        role = self.door.role_of(request)
        if not isinstance(role, Role):
            if token is not None:
                self.counts["login"] += 1
            return None
        return Access(role, self.door.globs, client=session.peer, tally=self.denied)

    def replace_door(self, door: Door) -> None:
        """Tokens, roles and rules are others now: every node has to say who it is again."""
        self.door = door
        for session in list(self.sessions):
            session.close("login", "what this node may do has changed; connect again")

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(min(_TICK_S, self.unfinished_s / 2, self.silence_s / 2))
            now = time.monotonic()
            for session in list(self.sessions):
                if session.began is not None and now - session.began > self.unfinished_s:
                    self.counts["slow"] += 1
                    session.close("malformed", f"a packet was not complete within {self.unfinished_s:g} s")
                elif session.upgraded and now - session.last_heard > self.silence_s:
                    self.counts["silent"] += 1
                    session.close("timeout", f"nothing was heard for {self.silence_s:g} s")


def _no_text(entry: Entry) -> bytes:
    raise NodeError("conversion", f"it is a message of {entry.type}, which nobody makes text of here")


def _keep_alive(sock: Any) -> None:
    """An old node says nothing for hours; one that was switched off is noticed all the same."""
    if sock is not None and sock.family in (socket.AF_INET, socket.AF_INET6):
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in (("TCP_KEEPIDLE", 30), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 3)):
            if hasattr(socket, option):
                sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
