"""Listens for IoRT nodes: thousands of connections on one event loop, each with a session."""

from __future__ import annotations

import asyncio
import itertools
import json
import logging
import ssl
import time
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, Final
from urllib.parse import urlsplit

from ropeway.errors import ConnectFailed
from ropeway.fault_log import FaultLog
from ropeway.iort import DEFAULT_PORT, MAX_PACKET_BYTES, NOT_HTTP, NodeError
from ropeway.limits import LOGIN_S, NODE_PACKET_S, NODE_SILENCE_S
from ropeway.listener.authorization import Access, Role
from ropeway.listener.connection import peer_address
from ropeway.listener.entrance import Entrance
from ropeway.listener.http import HttpRequest
from ropeway.listener.http_upgrade import identified
from ropeway.listener.listener import Listener, keep_alive, open_listener
from ropeway.networks.iort.server.session import IortSession
from ropeway.networks.iort.space import Space
from ropeway.store import Entry
from ropeway.tasks import Chores, Supervised, end

__all__ = ["IortServer"]

log = logging.getLogger("ropeway.iort")

_TICK_S: Final = 1.0
_MAX_CLIENTS: Final = 10_000
_HANDSHAKE_S: Final = 10.0
_SHOWN_NODES: Final = 100  # of thousands, in a status that is printed every second


class IortServer:
    """Serves a space to nodes; ``entrance`` decides who may come in and do what.

    A node is in once it has a role: from the start, where its certificate or the default gives it one, else after a
    ``+hello`` with a token, for which it has ``login_s``. Until then it has no part in the space.

    ``max_packet_bytes`` bounds one packet. A node has ``unfinished_s`` for each of its packets. One that pings is given
    up after ``silence_s`` without a word; whether one is there that only reads is asked by TCP. ``render`` makes text
    of messages of ROS, which nodes cannot read; it raises ``NodeError`` or ``TypesError`` where it cannot.
    ``kinds`` says by their identifiers which plain nodes are a ``robot`` or a ``pc``; others tell it themselves.
    """

    def __init__(
        self,
        space: Space,
        *,
        entrance: Entrance | None = None,
        max_packet_bytes: int = MAX_PACKET_BYTES,
        max_clients: int = _MAX_CLIENTS,
        unfinished_s: float = NODE_PACKET_S,
        silence_s: float = NODE_SILENCE_S,
        login_s: float = LOGIN_S,
        render: Callable[[Entry], bytes] | None = None,
        kinds: Mapping[str, str] | None = None,
    ) -> None:
        self.space, self.entrance = space, entrance or Entrance()
        self.max_packet_bytes, self.max_clients = max_packet_bytes, max_clients
        self.unfinished_s, self.silence_s, self.login_s = unfinished_s, silence_s, login_s
        self.render = render or _no_text
        self.kinds = dict(kinds or {})
        self.sessions: dict[IortSession, None] = {}
        self.counts: Counter[str] = Counter()
        self.denied: Counter[str] = Counter()
        self._fault_log = FaultLog("iort")
        self.listeners: list[Listener] = []
        self._tasks = Chores()
        self._ticker: Supervised | None = None
        self._names: Counter[str] = Counter()
        self._strangers: set[IortSession] = set()  # connected, but not in

    async def listen(self, url: str, *, ssl_context: ssl.SSLContext | None = None, reuse_port: bool = False) -> int:
        """Listen on ``iort://host:port`` or ``iorts://host:port``; the port is returned. Raises ``ConnectFailed``."""
        parts = urlsplit(url)
        if parts.scheme == "iorts" and ssl_context is None:
            raise ConnectFailed(url, "iorts needs a certificate and a key", retryable=False)
        host, port = parts.hostname or "127.0.0.1", DEFAULT_PORT if parts.port is None else parts.port
        named = f"{parts.scheme}://[{host}]" if ":" in host else f"{parts.scheme}://{host}"
        listener = await open_listener(
            f"{named}:{port}",
            host,
            port,
            lambda visit: IortSession(self, visit),
            lobby=self.entrance.lobby,
            handshake_s=_HANDSHAKE_S,
            context=ssl_context if parts.scheme == "iorts" else None,
            reuse_port=reuse_port,
            many=True,
        )
        self.listeners.append(listener)
        if self._ticker is None:
            self._ticker = Supervised(self._tick, "iort server ticks").start()
        log.info("listening on %s:%d", named, listener.port)
        return listener.port

    async def close(self) -> None:
        """Stop listening, and end every session."""
        for listener in self.listeners:
            await listener.close()
        for session in [*self.sessions, *self._strangers]:
            session.close("closed", "the server stops")
        await end(self._ticker)
        await self._tasks.close()
        self._ticker = None
        self.listeners.clear()

    def status(self) -> dict[str, Any]:
        """Return the state of the server as JSON."""
        return {
            "listen": [{"address": listener.address, "port": listener.port} for listener in self.listeners],
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
        """Start a task that ends with the server."""
        self._tasks.start(work, "request of a node")

    # ── what sessions call ─────────────────────────────────────────────────────────────────────────────────────

    def welcome(self, session: IortSession, transport: asyncio.Transport) -> None:
        """Take a node that connected: it is let in when something comes of it, or when it says who it is."""
        keep_alive(transport)
        session.peer = session.node = peer_address(transport.get_extra_info("peername"))
        self.counts["connections"] += 1
        self._strangers.add(session)
        if not isinstance(self.entrance.door.role_of(_request(transport)), Role):
            session.expect_login(self.login_s)

    def heard(self, session: IortSession) -> bool:
        """Let a node in of which the first has come, unless it has to say who it is; return whether it may stay."""
        assert session.transport is not None
        role = self.entrance.door.role_of(_request(session.transport))
        if isinstance(role, Role):
            try:
                self._let_in(session, role)
            except NodeError:
                session.close()
                return False
        return True

    def gone(self, session: IortSession) -> None:
        """Forget a node, which is gone."""
        self._strangers.discard(session)
        if session in self.sessions:
            del self.sessions[session]
            self.space.leave(session)
            self._rename(session, "")
            assert session.access is not None
            self.entrance.left(session.access.role)

    def hello(self, session: IortSession, name: str, token: str | None) -> str:
        """Admit a node that says who it is, and return what it should know.

        Raises ``NodeError`` if it may not come in.
        """
        transport = session.transport
        assert transport is not None
        if len(name) > 200 or not name.isprintable():
            raise NodeError("name", "the name of a node is short and can be printed")
        role = self.entrance.admit(_request(transport, token))
        if not isinstance(role, Role):
            self.counts["login"] += 1
            text = str(json.loads(role.body)["error"])
            raise NodeError("login", text if token is not None else "a known token or certificate is needed")
        self._let_in(session, role)
        self._rename(session, name)
        if self._names[name] > 1:
            self.counts["two of one name"] += 1
            self._fault_log.note("name", "", f"{session.peer}: another node is named {name}, too; both are served")
            return f"another node is named {name}, too"
        return ""

    def too_late(self, session: IortSession) -> None:
        """Give up a node that did not say who it is."""
        self.counts["no login"] += 1
        self._fault_log.note("login", "", f"{session.peer} did not say who it is within {self.login_s:g} s")
        session.close("login", f"say who you are within {self.login_s:g} s")

    def browser_came(self, session: IortSession) -> None:
        """Send a browser away."""
        assert session.transport is not None
        self.counts["http"] += 1
        self._fault_log.note("http", "", f"{session.peer} speaks HTTP; to a browser this port is closed")
        session.transport.write(NOT_HTTP)
        session.transport.close()

    def _let_in(self, session: IortSession, role: Role) -> None:
        """Give a node its role, and a part in the space. Raises ``NodeError`` where there is no place for it."""
        before = session.access.role if session.access is not None else None
        full = self.entrance.full(role) if before is None or before.name != role.name else ""
        if before is None and len(self.sessions) >= self.max_clients:
            full = f"there are {self.max_clients} nodes, and no more may come"
        if full:
            self.counts["no place"] += 1
            self._fault_log.note("place", "", f"{session.peer} is not let in: {full}")
            raise NodeError("full", full)
        if before is None:
            self._strangers.discard(session)
            self.sessions[session] = None
            self.space.join(session)
        else:
            self.entrance.left(before)
        self.entrance.came(role)
        size = min(self.max_packet_bytes, role.max_message_bytes or self.max_packet_bytes)
        entrance = self.entrance
        access = Access(role, entrance.door.globs, client=session.peer, tally=self.denied, audit=entrance.audit)
        session.let_in(access, size)

    def _rename(self, session: IortSession, name: str) -> None:
        self._names[session.node] -= 1
        if self._names[session.node] <= 0:
            del self._names[session.node]
        if name:
            session.node = name
            self._names[name] += 1

    def recheck(self) -> None:
        """Make every node log in again: tokens, roles and rules have changed."""
        for session in [*self.sessions, *self._strangers]:
            session.close("login", "what this node may do has changed; connect again")

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(min(_TICK_S, self.unfinished_s / 2, self.silence_s / 2))
            self._close_silent()

    def _close_silent(self) -> None:
        """Close whoever is too slow; a function of its own, so that no session is held from one look to the next."""
        now = time.monotonic()
        for session in [*self.sessions, *self._strangers]:
            if session.began is not None and now - session.began > self.unfinished_s:
                self.counts["slow"] += 1
                session.close("malformed", f"a packet was not complete within {self.unfinished_s:g} s")
            elif session.pings and now - session.last_heard > self.silence_s:
                self.counts["silent"] += 1
                session.close("timeout", f"nothing was heard for {self.silence_s:g} s")


def _no_text(entry: Entry) -> bytes:
    raise NodeError("conversion", f"it is a message of {entry.type}, which nobody makes text of here")


def _request(transport: asyncio.Transport, token: str | None = None) -> HttpRequest:
    """Return what a node shows as the request that a client of HTTP would send."""
    headers = {} if token is None else {"authorization": f"Bearer {token}"}
    return identified(HttpRequest("GET", "/", "HTTP/1.1", headers), transport)
