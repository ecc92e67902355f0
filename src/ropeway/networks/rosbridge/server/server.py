"""The server: listens, and gives every client a session."""

from __future__ import annotations

import asyncio
import logging
import ssl
import weakref
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from ropeway.errors import ConnectFailed, RopewayError
from ropeway.graph.calls import DEFAULT_TIMEOUT_S
from ropeway.graph.ros1_spelling import ros1_spelling
from ropeway.listener.authentication import Rejection, refusal, subprotocol, unserved
from ropeway.listener.authorization import EVERYTHING, Access, Role
from ropeway.listener.client_pages import ClientPages, preflight
from ropeway.listener.connection import Connection, Limits
from ropeway.listener.entrance import Entrance, narrowed
from ropeway.listener.globs import Globs
from ropeway.listener.http import HttpRequest, Response
from ropeway.listener.http_upgrade import Admission
from ropeway.listener.listener import Listener
from ropeway.listener.presence import Presence, ip_address
from ropeway.listener.store_watcher import StoreWatcher
from ropeway.listener.subprotocols import GATEWAY_SUBPROTOCOLS, ROPEWAY_SUBPROTOCOL, Guests
from ropeway.listener.watchers import Watchers
from ropeway.listener.websocket import listen
from ropeway.networks.rosbridge.link.express import HEADER
from ropeway.networks.rosbridge.rosapi import Rosapi
from ropeway.networks.rosbridge.server.http import Pages
from ropeway.networks.rosbridge.server.lingering import Lingering
from ropeway.networks.rosbridge.server.names import Names
from ropeway.networks.rosbridge.server.rosout import Rosout
from ropeway.networks.rosbridge.server.session import Session
from ropeway.tasks import Supervised, end

if TYPE_CHECKING:
    from ropeway.hub.hub import Hub
    from ropeway.types import TypeRegistry

__all__ = ["RosbridgeServer"]

log = logging.getLogger("ropeway.server")

_CLIENT_SILENCE_S = 30.0  # a browser tab or a robot on Wi-Fi may pause; a gateway may not
_CLIENT_PING_S = 5.0
_STOPS = "the gateway stops"
_GIVE_UP_S = 2.0  # for goals to be cancelled where they are carried out


class RosbridgeServer:
    """Serves the graph of ``hub`` to rosbridge clients and gateways.

    ``unregister_timeout_s``: how long a topic stays advertised after its last client withdrew it or left (rosbridge's
    default is 10 s), so that what it said last is heard. ``rosapi_globs`` limits what rosapi shows, and
    ``params_timeout_s`` bounds what it asks of nodes. Private names of clients (``~/x``) are those of our
    ``node``. ``publish_clients`` publishes ``/client_count`` and ``/connected_clients``, ``publish_rosout`` our own
    warnings and errors on ``/rosout``, from the first ``listen`` on. ``guests`` serve clients of other protocols.
    """

    def __init__(
        self,
        hub: Hub,
        registry: TypeRegistry,
        *,
        gateway_id: str = "",
        name: str = "ropeway",
        limits: Limits | None = None,
        unregister_timeout_s: float = 10.0,
        rosapi_globs: Globs | None = None,
        params_timeout_s: float = 5.0,
        publish_clients: bool = True,
        publish_rosout: bool = True,
        entrance: Entrance | None = None,
        reasons: Callable[[], Sequence[str]] = tuple,
        call_timeout_s: float = DEFAULT_TIMEOUT_S,
        silence_s: float | None = _CLIENT_SILENCE_S,
        ping_interval_s: float = _CLIENT_PING_S,
        cancel_goals: bool = True,
        pages: Sequence[ClientPages] = (),
        node: str = "",
        guests: Guests | None = None,
    ) -> None:
        self.hub, self.registry = hub, registry
        self.gateway_id, self.name = gateway_id, name
        self._names = Names(f"/{node or name}", ros1=hub.graph.kind == "ros1")
        self.limits = limits or Limits()
        self.unregister_timeout_s = unregister_timeout_s
        self.sessions: dict[Session, asyncio.Task[None]] = {}
        self._connections: weakref.WeakSet[Connection] = weakref.WeakSet()  # also second ones, and those sent away
        self.lingering = Lingering(unregister_timeout_s)
        self.listeners: list[Listener] = []
        self.entrance = entrance or Entrance()
        self.denied: Counter[str] = Counter()  # by rule, of all clients
        self.call_timeout_s, self.silence_s = call_timeout_s, silence_s
        self.ping_interval_s, self.cancel_goals = ping_interval_s, cancel_goals
        self._ros1 = ros1_spelling(hub.graph)
        self.rosapi = Rosapi(
            hub,
            registry,
            params_timeout_s=params_timeout_s,
            globs=rosapi_globs or self.entrance.door.globs,
            ros1=self._ros1,
        )
        self._pages = Pages(reasons, self.entrance.admit_page, self._more_pages)
        self.pages = pages
        self._guests = guests
        self._served = (*GATEWAY_SUBPROTOCOLS, *(() if guests is None else guests.subprotocols))
        self.watchers = Watchers()
        self.presence: Presence | None = None
        self.rosout: Rosout | None = None
        self._publish_clients, self._publish_rosout = publish_clients, publish_rosout
        self._view = hub.view("server", alone=True)
        self._ticker: Supervised | None = None

    async def listen(
        self, url: str, *, ssl_context: ssl.SSLContext | None = None, reuse_port: bool = False
    ) -> Listener:
        """Listen on ``ws://host:port`` or ``wss://host:port`` (9090 where the port is left out).

        Raises ``ConnectFailed`` if the address cannot be bound.
        """
        parts = urlsplit(url)
        if parts.scheme == "wss" and ssl_context is None:
            raise ConnectFailed(url, "wss needs a certificate and a key", retryable=False)
        port = 9090 if parts.port is None else parts.port
        await self._appear()
        server = await listen(
            parts.hostname or "127.0.0.1",
            port,
            self._connected,
            limits=self.limits,
            ssl_context=ssl_context,
            path=parts.path or "/",
            reuse_port=reuse_port,
            admit=self._admit,
            http=self._pages,
            lobby=self.entrance.lobby,
        )
        self.listeners.append(server)
        if self._ticker is None:
            self._ticker = Supervised(self._tick, "server meters").start()
        log.info("listening on %s://%s:%d", parts.scheme, parts.hostname, server.port)
        return server

    async def _appear(self) -> None:
        """Publish what rosbridge publishes about itself; a graph that does not take it is served without."""
        try:
            if self._publish_clients and self.presence is None:
                presence = Presence(self._view, self.registry)
                await presence.open()
                self.presence = presence
            if self._publish_rosout and self.rosout is None and self._ros1 is None:  # its log has another type there
                rosout = Rosout(self._view, self.registry)
                await rosout.open()
                self.rosout = rosout
        except RopewayError as error:
            log.warning("%s does not accept what the server says about itself: %s", self.hub.graph.name, error)

    def _more_pages(self, request: HttpRequest) -> Response | asyncio.Protocol | None:
        """Serve pages beyond the server's own to clients: values of the store, topics and services."""
        pages = next((pages for pages in self.pages if pages.knows(request.path)), None)
        if pages is None:
            return None
        asked = preflight(request, pages.cross_origin_methods) if pages.cross_origin_methods else None
        if asked is not None:
            return self.entrance.admit_page(request) or asked
        role = self.entrance.admit(request)
        if not isinstance(role, Role):
            return role
        found = pages(request, self._access(role, request.peer))
        if not isinstance(found, StoreWatcher):
            return found
        crowded = self._crowded(role)
        if crowded is None and (full := self.watchers.full(request)):
            crowded = refusal(503, full, Retry_After="10")
        if crowded is not None:
            return self.entrance.refuse(request, crowded)
        found.request = request
        found.on_begin, found.on_end = self._watcher_came, self._watcher_left
        return found

    def _watcher_came(self, watcher: StoreWatcher) -> None:
        self.watchers.add(watcher)
        self.entrance.came(watcher.access.role)

    def _watcher_left(self, watcher: StoreWatcher) -> None:
        self.watchers.discard(watcher)
        self.entrance.left(watcher.access.role)

    def _admit(self, request: HttpRequest) -> Admission | Response:
        role = self.entrance.admit(request)
        if not isinstance(role, Role):
            return role
        if self._link_of(request) is None:
            found = self._refusal(role, request)
            if found is not None:
                return self.entrance.refuse(request, found)
        return Admission(subprotocol(request, self._served), narrowed(self.limits, role), role)

    def _refusal(self, role: Role, request: HttpRequest) -> Rejection | None:
        """Return the answer to a client of this role that is allowed in, but not now or not like this."""
        crowded = self._crowded(role)
        if crowded is not None:
            return crowded
        offered = unserved(request, self._served)
        return refusal(400, offered) if offered else None

    def _crowded(self, role: Role) -> Rejection | None:
        guests = 0 if self._guests is None else len(self._guests)
        return self.entrance.crowded(role, self.limits, len(self.sessions) + len(self.watchers) + guests)

    def recheck(self, *, certificates: bool = False) -> None:
        """Disconnect clients that would no longer come in with the same role (1008): the rules have changed.

        With ``certificates`` whoever showed one has to show it again. Globs of rosapi stay as they were.
        """
        keeps = self.entrance.keeps
        for session in self.sessions:
            connection = session.peer.connection
            if not keeps(connection.handshake, session.access.role, certificates=certificates):
                self.entrance.tell_kicked(connection.peer, session.access.role)
                connection.close(1008, "what this client may do has changed; connect again")
        for pages in self.pages:
            pages.recheck(lambda request, role: keeps(request, role, certificates=certificates))
        for watcher in self.watchers:
            if not keeps(watcher.request, watcher.access.role, certificates=certificates):
                watcher.end()

    def _access(self, role: Role, peer: str) -> Access:
        ros1 = self.hub.graph.kind == "ros1"
        return Access(
            role,
            self.entrance.door.globs,
            client=peer,
            tally=self.denied,
            is_own=self.rosapi.serves,
            ros1_actions=self.hub.graph.actions if ros1 else None,
            audit=self.entrance.audit,
        )

    def _link_of(self, request: HttpRequest | None) -> Session | None:
        """Return the session whose second connection a request is for, if it shows the secret of one."""
        secret = "" if request is None else request.headers.get(HEADER.lower(), "")
        if not secret:
            return None
        return next((session for session in self.sessions if session.peer.express.knows(secret)), None)

    def _connected(self, connection: Connection) -> None:
        self._connections.add(connection)
        request = connection.handshake
        if request is not None and HEADER.lower() in request.headers:
            link = self._link_of(request)
            if link is not None and link.access.role == connection.grant and not link.peer.connection.closed:
                link.peer.express.attach(connection)
            else:
                connection.close(1008, "there is no link with this secret")
            return
        if self._guests is not None and connection.subprotocol in self._guests.subprotocols:
            self._guests.welcome(connection)
            return
        if connection.subprotocol != ROPEWAY_SUBPROTOCOL:
            connection.silence_s = self.silence_s
            if connection.ping_interval_s is not None:
                connection.ping_interval_s = self.ping_interval_s
        role = connection.grant if isinstance(connection.grant, Role) else EVERYTHING
        session = Session(
            connection,
            self.hub,
            self.registry,
            gateway_id=self.gateway_id,
            name=self.name,
            unregister_timeout_s=self.unregister_timeout_s,
            on_advertised=self.lingering.advertised,
            call_timeout_s=self.call_timeout_s,
            cancel_goals=self.cancel_goals,
            access=self._access(role, connection.peer),
            rosapi=self.rosapi,
            names=self._names,
            ros1=self._ros1,
        )
        session.all_sessions = self.sessions.keys
        task = asyncio.create_task(session.run(), name=f"session {connection.peer}")
        self.sessions[session] = task
        self.entrance.came(role)
        if self.presence is not None:
            self.presence.joined(session, ip_address(connection.peer))
        log.info(
            "%s: client connected (%s), %d in total", connection.peer, session.peer.dialect.name, len(self.sessions)
        )
        task.add_done_callback(lambda finished: self._ended(session, finished))

    def _ended(self, session: Session, task: asyncio.Task[None]) -> None:
        self.sessions.pop(session, None)
        self.entrance.left(session.access.role)
        if self.presence is not None:
            self.presence.left(session)
        peer = session.peer.connection.peer
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("%s: the session failed: %s", peer, error, exc_info=error)
            session.peer.connection.close(1011, "internal error")
        log.info("%s: client disconnected, %d in total", peer, len(self.sessions))
        if session.lingers:
            self.lingering.add(session)

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(1.0)
            self._tick_all()

    def _tick_all(self) -> None:
        """Have every session look at its meters; a function of its own, so that none is held from one to the next."""
        for session in list(self.sessions):
            try:
                session.tick()
            except Exception:  # of one session: the others are served as ever
                log.exception("%s: the session failed", session.peer.connection.peer)
                session.peer.connection.close(1011, "internal error")

    def status(self) -> dict[str, Any]:
        """Return what was denied, and how many watch the store, as JSON."""
        return {"denied": dict(self.denied), "clients": {"watchers": len(self.watchers)}}

    async def close(self) -> None:
        """Stop listening and end every session (1001, going away)."""
        try:
            await self._close_sessions()
        finally:
            await self._vanish()

    async def _close_sessions(self) -> None:
        for listener in self.listeners:
            await listener.close()
        for watcher in self.watchers:
            watcher.end()
        self.listeners.clear()
        await end(self._ticker)
        self._ticker = None
        tasks = list(self.sessions.values())
        connections = list(self._connections)
        giving_up = [asyncio.create_task(session.give_up(_STOPS)) for session in self.sessions]
        if giving_up:
            await asyncio.wait(giving_up, timeout=_GIVE_UP_S)
            await end(*giving_up)
            await asyncio.sleep(0)  # answers are sent at the end of a turn of the loop
        for connection in connections:
            connection.close(1001, _STOPS)
        for session in list(self.sessions):
            session.lost(1001, _STOPS)
        if tasks:
            await asyncio.wait(tasks, timeout=5)
        await self.lingering.close()
        for connection in connections:
            await connection.wait_closed()  # within a second, see ``Connection.close``

    async def _vanish(self) -> None:
        """Tell nothing more about ourselves."""
        await self.rosapi.close()
        if self.rosout is not None:
            await self.rosout.finish()
        if self.presence is not None:
            await self.presence.close()
        self.presence = self.rosout = None
        await self._view.close()
