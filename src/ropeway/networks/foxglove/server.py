"""The server of viewers: lets them in at a listener of its own, or as guests of the rosbridge server's."""

from __future__ import annotations

import asyncio
import logging
import os
import ssl
from collections import Counter
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from ropeway.errors import ConnectFailed, InvalidOperation
from ropeway.graph.calls import DEFAULT_TIMEOUT_S
from ropeway.graph.layout_border import Distributed
from ropeway.graph.parameter_server import ParameterServer
from ropeway.graph.ros1_spelling import ros1_spelling
from ropeway.listener.authentication import refusal, subprotocol, unserved
from ropeway.listener.authorization import EVERYTHING, Access, Role
from ropeway.listener.connection import Limits
from ropeway.listener.entrance import Entrance, narrowed
from ropeway.listener.http_upgrade import Admission
from ropeway.listener.subprotocols import FOXGLOVE_SUBPROTOCOLS
from ropeway.listener.websocket import listen
from ropeway.networks.foxglove.assets import Assets
from ropeway.networks.foxglove.channels import Catalogue, SchemaWriter
from ropeway.networks.foxglove.events import clock, parameter_events
from ropeway.networks.foxglove.parameters import MASTER_SERVICES, parameter_source
from ropeway.networks.foxglove.session import ViewerSession
from ropeway.networks.foxglove.settings import FoxgloveSettings
from ropeway.networks.foxglove.wire import dumps
from ropeway.tasks import Chores, Supervised, end

if TYPE_CHECKING:
    from ropeway.hub.hub import Hub
    from ropeway.listener.connection import Connection
    from ropeway.listener.http import HttpRequest, Response
    from ropeway.listener.listener import Listener
    from ropeway.types import TypeRegistry

__all__ = ["FoxgloveServer"]

log = logging.getLogger("ropeway.server")

_PORT: Final = 8765  # where viewers look unless they are told otherwise
_SILENCE_S: Final = 30.0  # as of rosbridge clients
_PING_S: Final = 5.0
_STOPS: Final = "the gateway stops"
_LEAVE_S: Final = 5.0  # for sessions to withdraw what they have


class FoxgloveServer:
    """Serves the graph of ``hub`` to viewers that speak the Foxglove WebSocket protocol.

    ``settings`` say what they are shown; ``entrance`` who comes in, with which rights. Nothing is read, and nothing is
    looked for, while no viewer is there.
    """

    def __init__(
        self,
        hub: Hub,
        registry: TypeRegistry,
        settings: FoxgloveSettings | None = None,
        *,
        name: str = "ropeway",
        limits: Limits | None = None,
        entrance: Entrance | None = None,
        call_timeout_s: float = DEFAULT_TIMEOUT_S,
        params_timeout_s: float = DEFAULT_TIMEOUT_S,
        silence_s: float | None = _SILENCE_S,
        ping_interval_s: float = _PING_S,
    ) -> None:
        self.hub, self.registry, self.settings = hub, registry, settings or FoxgloveSettings()
        self.limits, self.entrance = limits or Limits(), entrance or Entrance()
        self.silence_s, self.ping_interval_s = silence_s, ping_interval_s
        self.sessions: dict[ViewerSession, asyncio.Task[None]] = {}
        self.listeners: list[Listener] = []
        self.denied: Counter[str] = Counter()  # by rule, of all viewers
        self.writer = SchemaWriter(registry, ros1_spelling(hub.graph))
        self._view = hub.view("viewers", alone=True)
        self.catalogue = Catalogue(self._view, self.writer, self.settings, self._tell_all)
        self._offered = self._capabilities()
        self.parameters = parameter_source(self._view, registry, self.settings, params_timeout_s)
        self.assets = Assets(self.settings)
        self.call_timeout_s = call_timeout_s
        self._events = parameter_events(self._view, registry, self._parameter_changed)
        self._clock = clock(self._view, registry, self._time)
        self._name, self._id = name, os.urandom(8).hex()
        self._ticker: Supervised | None = None
        self._chores = Chores()

    def _capabilities(self) -> frozenset[str]:
        """Return the parts of the protocol that viewers may use: those that are left on, where they can be had."""
        settings = self.settings
        found = set(settings.capabilities)
        if not settings.asset_roots:
            found.discard("assets")
        if isinstance(self.hub.graph, ParameterServer):
            found.discard("parametersSubscribe")  # a master tells changes to nodes alone
        if settings.sim_time:
            found.add("time")
        return frozenset(found)

    @property
    def greeting(self) -> bytes:
        """See ``Place.greeting``."""
        graph, metadata = self.hub.graph, {}
        if isinstance(graph, Distributed) and graph.distro:
            metadata["ROS_DISTRO"] = graph.distro
        about = {
            "op": "serverInfo",
            "name": self._name,
            "capabilities": sorted(self._offered),
            "supportedEncodings": [self.writer.encoding, "json"],
            "metadata": metadata,  # what is known of the network by now
            "sessionId": self._id,
        }
        return dumps(about)

    @property
    def subprotocols(self) -> tuple[str, ...]:
        """See ``Guests.subprotocols``."""
        return FOXGLOVE_SUBPROTOCOLS

    def __len__(self) -> int:
        """Return how many viewers there are."""
        return len(self.sessions)

    # ── the door ───────────────────────────────────────────────────────────────────────────────────────────────

    async def listen(
        self, url: str, *, ssl_context: ssl.SSLContext | None = None, reuse_port: bool = False
    ) -> Listener:
        """Listen on ``foxglove://host:port`` or ``foxgloves://host:port`` (8765 where the port is left out).

        Raises ``ConnectFailed`` if the address cannot be bound.
        """
        parts = urlsplit(url)
        if parts.scheme == "foxgloves" and ssl_context is None:
            raise ConnectFailed(url, "foxgloves needs a certificate and a key", retryable=False)
        server = await listen(
            parts.hostname or "127.0.0.1",
            _PORT if parts.port is None else parts.port,
            self.welcome,
            limits=self.limits,
            ssl_context=ssl_context,
            reuse_port=reuse_port,
            admit=self._admit,
            lobby=self.entrance.lobby,
        )
        self.listeners.append(server)
        log.info("listening for viewers on %s://%s:%d", parts.scheme, parts.hostname, server.port)
        return server

    def _admit(self, request: HttpRequest) -> Admission | Response:
        role = self.entrance.admit(request)
        if not isinstance(role, Role):
            return role
        crowded = self.entrance.crowded(role, self.limits, len(self))
        if crowded is not None:
            return self.entrance.refuse(request, crowded)
        if wrong := unserved(request, self.subprotocols, plain=False):
            return self.entrance.refuse(request, refusal(400, wrong))
        return Admission(subprotocol(request, self.subprotocols), narrowed(self.limits, role), role)

    def welcome(self, connection: Connection) -> None:
        """Begin the session of a viewer that was let in."""
        connection.silence_s = self.silence_s
        if connection.ping_interval_s is not None:
            connection.ping_interval_s = self.ping_interval_s
        role = connection.grant if isinstance(connection.grant, Role) else EVERYTHING
        graph = self.hub.graph
        access = Access(
            role,
            self.entrance.door.globs,
            client=connection.peer,
            tally=self.denied,
            is_own=MASTER_SERVICES.__contains__ if isinstance(graph, ParameterServer) else None,
            ros1_actions=graph.actions if graph.kind == "ros1" else None,
            audit=self.entrance.audit,
        )
        self.catalogue.start()
        self._settle_shared()
        if self._ticker is None:
            self._ticker = Supervised(self._tick, "meters of viewers").start()
        session = ViewerSession(connection, self.hub.view(connection.peer, echo=True), access, self)
        task = asyncio.create_task(session.run(), name=f"viewer {connection.peer}")
        self.sessions[session] = task
        self.entrance.came(role)
        log.info("%s: viewer connected (%s), %d in total", connection.peer, connection.subprotocol, len(self))
        task.add_done_callback(lambda finished: self._ended(session, finished))

    def _ended(self, session: ViewerSession, task: asyncio.Task[None]) -> None:
        self.sessions.pop(session, None)
        self.entrance.left(session.access.role)
        peer = session.connection.peer
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("%s: the session failed: %s", peer, error, exc_info=error)
            session.connection.close(1011, "internal error")
        log.info("%s: viewer disconnected, %d in total", peer, len(self))
        if not self.sessions:
            self._chores.start(self.catalogue.stop(), "end of looking for channels")
        self._settle_shared()

    def recheck(self, *, certificates: bool = False) -> None:
        """Disconnect viewers that would no longer come in with the same role (1008): the rules have changed.

        With ``certificates`` whoever showed one has to show it again.
        """
        for session in self.sessions:
            connection = session.connection
            if not self.entrance.keeps(connection.handshake, session.access.role, certificates=certificates):
                self.entrance.tell_kicked(connection.peer, session.access.role)
                connection.close(1008, "what this client may do has changed; connect again")

    # ── what sessions share ────────────────────────────────────────────────────────────────────────────────────

    def offers(self, capability: str) -> bool:
        """See ``Place.offers``."""
        return capability in self._offered

    def check_offered(self, capability: str, op: str) -> None:
        """See ``Place.check_offered``."""
        if capability not in self._offered:
            raise InvalidOperation(op, f"this server does not offer {capability}")

    def watch_parameters(self) -> None:
        """See ``Place.watch_parameters``."""
        self._settle_shared()

    def _settle_shared(self) -> None:
        """Read what all viewers share while one of them wants it."""
        if self.settings.sim_time:
            self._chores.start(self._clock.settle(lambda: bool(self.sessions)), "clock for viewers")
        if "parametersSubscribe" in self._offered:
            watched = self._events.settle(lambda: any(session.questions.watched for session in self.sessions))
            self._chores.start(watched, "parameters for viewers")

    def _parameter_changed(self, name: str, value: Any) -> None:
        for session in list(self.sessions):
            session.parameter_changed(name, value)

    def _time(self, time_ns: int) -> None:
        for session in list(self.sessions):
            session.sender.tell_time(time_ns)

    def _tell_all(self) -> None:
        for session in list(self.sessions):
            session.tell()

    async def _tick(self) -> None:
        while True:
            await asyncio.sleep(1.0)
            self._tick_all()

    def _tick_all(self) -> None:
        """Have every session look at its meters; a function of its own, so that none is held from one to the next."""
        self.catalogue.look_for_types()
        for session in list(self.sessions):
            try:
                session.tick()
            except Exception:  # of one session: the others are served as ever
                log.exception("%s: the session failed", session.connection.peer)
                session.connection.close(1011, "internal error")

    def status(self) -> dict[str, Any]:
        """Return what was denied, as JSON."""
        return {"denied": dict(self.denied)}

    async def close(self) -> None:
        """Stop listening and end every session (1001, going away)."""
        for listener in self.listeners:
            await listener.close()
        self.listeners.clear()
        await end(self._ticker)
        self._ticker = None
        tasks, connections = list(self.sessions.values()), [session.connection for session in self.sessions]
        for session in list(self.sessions):
            await session.calls.give_up(_STOPS)
            session.connection.close(1001, _STOPS)
            session.leave()
        if tasks:
            await asyncio.wait(tasks, timeout=_LEAVE_S)
        await self.catalogue.stop()
        await self._chores.close()
        await self._view.close()
        for connection in connections:
            await connection.wait_closed()  # within a second, see ``Connection.close``
