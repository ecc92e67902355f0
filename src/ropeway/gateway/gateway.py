"""A gateway in this process: brings a configuration up as the paper's Algorithm 1 has it, and takes it down."""

from __future__ import annotations

import asyncio
import logging
import os
import ssl
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING, Any, Final

from ropeway.audit.note import NO_AUDIT, Auditor
from ropeway.delivery.codec_times import codec_status
from ropeway.errors import RopewayError
from ropeway.gateway.apply import ConfigChange
from ropeway.gateway.auth import make_door, warn_of_tokens
from ropeway.gateway.config.address import is_foxglove, is_iort, is_secure
from ropeway.gateway.config.config import Config, Route
from ropeway.gateway.config.type_hints import learn_types, type_hints
from ropeway.gateway.credentials import read_credentials
from ropeway.gateway.explain import Explanation, RouteWatch, explain
from ropeway.gateway.graph_status import graph_status
from ropeway.gateway.local_networks import open_network
from ropeway.gateway.plan import ConfigPlan, make_plan
from ropeway.gateway.process.allocator import FreedMemory, keep_freed_memory
from ropeway.gateway.process.counts import summed
from ropeway.gateway.process.open_files import make_room
from ropeway.gateway.process.questions import Question
from ropeway.gateway.recording.recorders import Recorders
from ropeway.gateway.remote import Remote
from ropeway.gateway.remote_factory import RemoteFactory
from ropeway.gateway.route import RouteStatus, paused_status
from ropeway.gateway.running_remote import RunningRemote
from ropeway.gateway.stores import open_store
from ropeway.gateway.tls import server_context, trusted_files
from ropeway.gateway.topic_looks import TopicLooks
from ropeway.hub.hub import Hub
from ropeway.listener.connection import Limits
from ropeway.listener.entrance import Entrance
from ropeway.tasks import Supervised, failing
from ropeway.types import TypeRegistry

if TYPE_CHECKING:
    from ropeway.delivery.pipeline import Tap, Witness
    from ropeway.gateway.last_value import LastValue
    from ropeway.gateway.nodes import Nodes
    from ropeway.gateway.rest.outgoing import WebRule
    from ropeway.gateway.safety import GuardedTopic
    from ropeway.listener.client_pages import ClientPages
    from ropeway.listener.listener import Listener
    from ropeway.networks.foxglove.server import FoxgloveServer
    from ropeway.networks.foxglove.session import ViewerSession
    from ropeway.networks.overlay.node import OverlayNode
    from ropeway.networks.rosbridge.server import RosbridgeServer
    from ropeway.networks.rosbridge.server.session import Session
    from ropeway.store import Store

__all__ = ["Gateway"]

log = logging.getLogger("ropeway.gateway")

_METERS_S: Final = 1.0


class Gateway:
    """Runs a configuration: ``async with Gateway(config) as gateway: await gateway.wait()``.

    ``gateway_id`` names it to other gateways (8 random bytes unless given); ``reuse_port`` lets workers share a
    listener. ``audit`` takes notes for the audit log.
    """

    def __init__(
        self,
        config: Config,
        *,
        registry: TypeRegistry | None = None,
        gateway_id: str | None = None,
        node: str | None = None,
        reuse_port: bool = False,
        audit: Auditor = NO_AUDIT,
    ) -> None:
        self.registry = registry or TypeRegistry()
        self.gateway_id = gateway_id or os.urandom(8).hex()
        self._node = node
        self._reuse_port = reuse_port
        self.audit = audit
        self.change: ConfigChange | None = None  # what was prepared
        self._given_up: asyncio.Future[None] | None = None
        self._begin(config)

    def _begin(self, config: Config) -> None:
        """Be as before anything was brought up."""
        self.config = config
        self.hubs: dict[str, Hub] = {}
        self.servers: list[RosbridgeServer] = []
        self.viewers: FoxgloveServer | None = None
        self.running: list[RunningRemote] = []
        self.store: Store | None = None
        self.budget = config.gateway.budget()
        self.nodes: Nodes | None = None
        self._factory: RemoteFactory | None = None
        self.guarded: list[GuardedTopic] = []
        self.web: list[WebRule] = []
        self._stack = AsyncExitStack()
        self._tls: ssl.SSLContext | None = None
        self._trusted = b""
        self._entrance = Entrance(audit=self.audit)
        self._watch = RouteWatch(lambda: self.remotes)
        self.looks = TopicLooks(self.hubs, self.registry)
        self.recorders = Recorders(self, config.gateway.name, self._node)

    async def __aenter__(self) -> Gateway:
        """Bring everything up. Raises ``RopewayError`` if a graph or a listener cannot be had; nothing stays up."""
        async with AsyncExitStack() as stack:
            await self._bring_up(stack)
            self._stack = stack.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        """Take everything down, in the opposite order."""
        await self._stack.aclose()

    async def _bring_up(self, stack: AsyncExitStack) -> None:
        keep_freed_memory()
        freed = FreedMemory()
        self.budget.on_large_end = freed.due
        stack.callback(freed.close)
        settings = self.config.gateway
        learn_types(self.config, self.registry)
        for path, hint in type_hints(self.config, self.registry):
            log.warning("%s: %s", path, hint)
        self._entrance.door = make_door(settings)
        self._tls, self._trusted = server_context(settings.tls), trusted_files(settings.tls)
        for network in settings.networks:
            url = network.address
            graph = await open_network(
                network, registry=self.registry, name=self._node or settings.name, gateway_id=self.gateway_id
            )
            stack.push_async_callback(graph.close)
            hub = self.hubs[url] = Hub(graph, gateway_id=self.gateway_id)
            await hub.open()
            stack.push_async_callback(hub.close)
        stack.push_async_callback(self.looks.close)
        if self.config.safeties():
            from ropeway.gateway.safety import guard_topics

            self.guarded = await guard_topics(self.config.safeties(), self.hubs, self.registry, stack)
        if settings.listen:
            nodes = settings.iort.max_nodes if any(map(is_iort, settings.listen)) else 0
            room = make_room(settings.clients.max_clients + nodes)
            self._entrance.set_room(clients=room.clients, pending=room.pending)
        if self.config.stores:
            self.store = await open_store(self.config.gateway, stack)
        limits = Limits(max_message_bytes=settings.max_message_bytes, budget=self.budget)
        await self._bring_up_server(stack, limits)
        await self._bring_up_nodes(stack)
        self._factory = RemoteFactory(
            settings, self.registry, gateway_id=self.gateway_id, node_name=self._node or settings.name, limits=limits
        )
        stack.push_async_callback(self.recorders.close)
        await self.recorders.open(self.config)
        stack.push_async_callback(self._close_remotes)
        await self._bring_up_remotes()
        if settings.http:
            from ropeway.gateway.rest.outgoing import open_rules

            self.web = await open_rules(settings.http, self.hubs[settings.graphs[0]], self.registry, stack)
        stack.push_async_callback(Supervised(self._update_meters, "gateway meters").start().close)
        stack.push_async_callback(Supervised(self._watch.run, "gateway routes").start().close)
        if settings.diagnostics:
            from ropeway.gateway.diagnostics import Diagnostics

            await Diagnostics(settings.name, self.status, self.registry).open(self.hubs.values(), stack)

    async def _bring_up_server(self, stack: AsyncExitStack, limits: Limits) -> None:
        """Listen for rosbridge clients, gateways and viewers."""
        settings = self.config.gateway
        links = [url for url in settings.listen if not is_iort(url) and not is_foxglove(url)]
        viewers = [url for url in settings.listen if is_foxglove(url)]
        if viewers or (links and settings.foxglove.enabled):
            from ropeway.gateway.viewers import serve_viewers

            hub = self.hubs[settings.graphs[0]]
            self.viewers = serve_viewers(settings, hub, self.registry, limits, self._entrance)
            stack.push_async_callback(self.viewers.close)
            for url in viewers:
                secure = self._tls if is_secure(url) else None
                await self.viewers.listen(url, ssl_context=secure, reuse_port=self._reuse_port)
                warn_of_tokens(settings, url)
        if not links:
            return
        from ropeway.gateway.client_server import make_client_server  # a gateway that only dials does not need it

        server = make_client_server(
            settings,
            self.hubs[settings.graphs[0]],
            self.registry,
            gateway_id=self.gateway_id,
            node=self._node or settings.name,
            limits=limits,
            entrance=self._entrance,
            reasons=self.missing,
            pages=await self._pages(stack),
            guests=self.viewers if settings.foxglove.enabled else None,
        )
        stack.push_async_callback(server.close)
        self.servers.append(server)
        for url in links:
            secure = self._tls if is_secure(url) else None
            address = url + settings.clients.path.removesuffix("/")
            await server.listen(address, ssl_context=secure, reuse_port=self._reuse_port)
            warn_of_tokens(settings, url)

    async def _pages(self, stack: AsyncExitStack) -> list[ClientPages]:
        """Make what the rosbridge listeners serve beside WebSockets."""
        from ropeway.gateway.pages import client_pages

        hub = self.hubs[self.config.gateway.graphs[0]]
        return await client_pages(self.config.gateway, hub, self.registry, self.store, stack)

    async def _bring_up_nodes(self, stack: AsyncExitStack) -> None:
        """Listen for IoRT nodes, and share what the maps name with the first graph."""
        settings = self.config.gateway
        urls = [url for url in settings.listen if is_iort(url)]
        if not urls:
            return
        assert self.store is not None
        from ropeway.gateway.nodes import Nodes

        hub = self.hubs[settings.graphs[0]]
        into, out_of = hub.view("from nodes"), hub.view("to nodes")
        stack.push_async_callback(into.close)
        stack.push_async_callback(out_of.close)
        self.nodes = Nodes(
            settings.iort, self.store, into, out_of, self.registry, entrance=self._entrance, name=settings.name
        )
        await self.nodes.open()
        stack.push_async_callback(self.nodes.close)
        for url in urls:
            await self.nodes.listen(url, ssl_context=self._tls if is_secure(url) else None)
            warn_of_tokens(settings, url)

    async def _bring_up_remotes(self) -> None:
        routes: dict[int, list[Route]] = {}
        for route in self.config.routes():
            routes.setdefault(id(route.remote), []).append(route)
        for index, config in enumerate(self.config.remotes):
            mine = routes.get(id(config), [])
            if config.active and (mine or config.lasts):
                self.running.append(await self.open_remote(self.config, index, mine))

    async def open_remote(self, config: Config, index: int, routes: Sequence[Route]) -> RunningRemote:
        """Bring a remote of a configuration up, with its routes."""
        assert self._factory is not None
        remote = self._factory.make(config.remotes[index], index, routes)
        running = RunningRemote(self, remote, index, default_graph=config.gateway.graphs[0])
        await running.open(routes)
        return running

    async def _close_remotes(self) -> None:
        for running in reversed(self.running):
            await running.close()
        self.running.clear()

    @property
    def listening(self) -> list[RosbridgeServer | FoxgloveServer]:
        """The servers of clients and viewers."""
        return [*self.servers, *([] if self.viewers is None else [self.viewers])]

    @property
    def sessions(self) -> list[Session | ViewerSession]:
        """The clients, gateways and viewers that are connected."""
        viewers = [] if self.viewers is None else self.viewers.sessions
        return [*(session for server in self.servers for session in server.sessions), *viewers]

    @property
    def node(self) -> OverlayNode | None:
        """The node of the overlay, where a remote is there."""
        return None if self._factory is None else self._factory.node

    @property
    def remotes(self) -> list[Remote]:
        """The remotes that are up, in the order of the configuration."""
        return [running.remote for running in self.running]

    def keeper(self, route: Route) -> LastValue | None:
        """Return what keeps the last message of a route, if its configuration asks for it."""
        if not route.options.store:
            return None
        assert self.store is not None
        from ropeway.gateway.last_value import LastValue, key_of

        return LastValue(self.store, *key_of(route.name, self.config.gateway.name), route.type)

    def tap(self, route: Route) -> Tap | None:
        """Return what records what crosses a route, if a recorder wants it."""
        return self.recorders.tap(route)

    def witness(self, route: Route) -> Witness | None:
        """Return what writes down what crosses a route, if its configuration asks for it."""
        if not route.options.audit:
            return None
        from ropeway.gateway.audit import route_witness

        return route_witness(self.audit, route)

    async def _update_meters(self) -> None:
        while True:
            await asyncio.sleep(_METERS_S)
            self._update_all_meters()

    def _update_all_meters(self) -> None:
        """Update the meters of all bridges; a function of its own, so that none is held from one time to the next."""
        for remote in self.remotes:
            for bridge in remote.topics():
                bridge.meter.update()
        for bridge in self.nodes.bridges.values() if self.nodes is not None else ():
            bridge.meter.update()

    def missing(self) -> list[str]:
        """Return why the gateway is not ready for clients, in sentences; empty once all graphs and listeners are up."""
        settings = self.config.gateway
        reasons = [f"{url} is not open" for url in settings.graphs if url not in self.hubs]
        up = sum(len(server.listeners) for server in self.listening)
        up += 0 if self.nodes is None else len(self.nodes.server.listeners)
        if up < len(settings.listen):
            reasons.append(f"{up} of {len(settings.listen)} listeners are up")
        return reasons

    def reload(self) -> None:
        """Read certificates and tokens again, for connections to come; clients whose token is gone are disconnected.

        So is who showed a certificate, if other authorities are trusted now, and a link to a remote, if others are
        trusted there. Raises ``ConfigError`` if the files are no good; everything then stays as it was.
        """
        shown = [read_credentials(running.config, running.index) for running in self.running]
        self.read_access(self.config)()
        for running, credentials in zip(self.running, shown, strict=True):
            running.remote.renew(credentials)
        log.info("%s has read its certificates and tokens again", self.config.gateway.name)

    def read_access(self, config: Config) -> Callable[[], None]:
        """Read who may come in by a configuration; return what makes it so. Raises ``ConfigError``."""
        settings = config.gateway
        door, context, trusted = make_door(settings), server_context(settings.tls), trusted_files(settings.tls)

        def renew() -> None:
            certificates = trusted != self._trusted
            self._entrance.door, self._tls, self._trusted = door, context, trusted
            for server in self.listening:
                _renew(server.listeners, context)
                server.recheck(certificates=certificates)
            if self.nodes is not None:
                _renew(self.nodes.server.listeners, context)
                self.nodes.server.recheck()

        return renew

    async def restart(self, config: Config) -> None:
        """Take everything down and bring another configuration up, or else the one before.

        Raises ``RopewayError`` if the new one does not come up. If the old one does not, either, ``wait`` raises.
        """
        before = self.config
        await self._stack.aclose()
        self._begin(config)
        try:
            await self.__aenter__()
        except RopewayError as error:
            log.error("%s; the configuration before is brought up again", error)
            self._begin(before)
            try:
                await self.__aenter__()
            except RopewayError as second:
                if self._given_up is not None and not self._given_up.done():
                    self._given_up.set_exception(second)
            raise

    async def apply(self, config: Config, plan: ConfigPlan | None = None) -> ConfigPlan:
        """Go over to another configuration while everything else goes on; return what was done.

        Raises ``RopewayError`` if that cannot be; then everything is as before.
        """
        change = await self.prepare(config, plan)
        self.change = None
        await change.commit()
        return change.plan

    async def prepare(self, config: Config, plan: ConfigPlan | None = None) -> ConfigChange:
        """Start what is new of a configuration beside what runs; what comes of it is ``change`` until then."""
        change = ConfigChange(self, plan or make_plan(self.config, config))
        await change.prepare()
        self.change = change
        return change

    def routes(self) -> list[RouteStatus]:
        """Return how every route is."""
        running = [row for remote in self.remotes for row in remote.routes()]
        return running + [paused_status(route) for route in self.config.routes(active=False)]

    async def ask(self, question: Question, params: Mapping[str, Any]) -> list[Any]:
        """Return the answer to a question as the only one in a list, as a ``Supervisor`` has one of each worker."""
        return [await question(self, params)]

    async def ask_one(self, question: Question, params: Mapping[str, Any]) -> Any:
        """Return the answer to a question that a ``Supervisor`` has one worker answer."""
        return await question(self, params)

    async def explain(self, name: str, to: str = "") -> list[Explanation]:
        """Explain why a name crosses to a remote or does not; see ``ropeway.gateway.explain``."""
        return await explain(self.remotes, name, to)

    def status(self) -> dict[str, Any]:
        """Return the state of everything as JSON."""
        return {
            "name": self.config.gateway.name,
            "graphs": [graph_status(url, hub) for url, hub in self.hubs.items()],
            "listen": [
                {"address": listener.address, "port": listener.port, "clients": len(server.sessions)}
                for server in self.listening
                for listener in server.listeners
            ],
            "remotes": [remote.status() for remote in self.remotes],
            "routes": [row.to_json() for row in self.routes()],
            "memory": self.budget.status(),
            "access": summed([self._entrance.status(), *(server.status() for server in self.listening)]),
            "sessions": [session.status() for session in self.sessions],
            **({} if self.store is None else {"store": self.store.status()}),
            **({} if self.nodes is None else {"nodes": self.nodes.status()}),
            **({"recordings": self.recorders.status()} if self.config.gateway.record else {}),
            **({"safety": [topic.status() for topic in self.guarded]} if self.guarded else {}),
            "codecs": codec_status(),
            **({"http": [rule.status() for rule in self.web]} if self.web else {}),
            "failed": failing(),
        }

    async def wait(self) -> None:
        """Run until cancelled. Raises ``RopewayError`` once nothing can be brought up any more."""
        if self._given_up is None:
            self._given_up = asyncio.get_running_loop().create_future()
        await asyncio.wait([self._given_up])
        self._given_up.result()


def _renew(listeners: Iterable[Listener], context: ssl.SSLContext | None) -> None:
    for listener in listeners:
        if listener.context is not None:
            listener.context = context
