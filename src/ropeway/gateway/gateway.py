"""A gateway in this process: brings a configuration up as the paper's Algorithm 1 has it, and takes it down."""

from __future__ import annotations

import asyncio
import logging
import os
import ssl
from collections.abc import Iterable, Mapping
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING, Any, Final

from ropeway.extras import require
from ropeway.gateway.auth import make_door
from ropeway.gateway.bridges import fetch, make_bridge
from ropeway.gateway.config.address import is_iort, is_loopback, is_secure
from ropeway.gateway.config.config import Config, Route
from ropeway.gateway.config.iort_model import StoreConfig
from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.config.overlay_model import OVERLAY
from ropeway.gateway.config.type_hints import learn_types, type_hints
from ropeway.gateway.credentials import read_credentials
from ropeway.gateway.dialler import Dialler
from ropeway.gateway.explain import Explanation, RouteWatch, explain
from ropeway.gateway.local_networks import open_network
from ropeway.gateway.process.allocator import FreedMemory, keep_freed_memory
from ropeway.gateway.process.counts import summed
from ropeway.gateway.process.open_files import make_room
from ropeway.gateway.process.questions import Question
from ropeway.gateway.remote import IortRemote, LinkRemote, OverlayRemote, Remote, shown_address
from ropeway.gateway.route import RouteStatus, RunningRoute
from ropeway.gateway.tls import server_context, trusted_files
from ropeway.graph.layout_border import Distributed
from ropeway.hub.hub import Hub, View
from ropeway.listener.connection import Limits
from ropeway.listener.entrance import Entrance
from ropeway.networks.rosbridge.client.by_interface import InterfaceGraph
from ropeway.tasks import Supervised, failing
from ropeway.types import TypeRegistry

if TYPE_CHECKING:
    from ropeway.gateway.group import GroupRemote
    from ropeway.gateway.last_value import LastValue
    from ropeway.gateway.nodes import Nodes
    from ropeway.listener.listener import Listener
    from ropeway.networks.overlay.graph import OverlayGraph
    from ropeway.networks.overlay.node import OverlayNode
    from ropeway.networks.rosbridge.server import RosbridgeServer
    from ropeway.store import Store

__all__ = ["Gateway"]

log = logging.getLogger("ropeway.gateway")

_METERS_S: Final = 1.0


class Gateway:
    """Runs a configuration: ``async with Gateway(config) as gateway: await gateway.wait()``.

    ``gateway_id`` names it to other gateways (8 random bytes unless given); ``reuse_port`` lets workers share a
    listener.
    """

    def __init__(
        self,
        config: Config,
        *,
        registry: TypeRegistry | None = None,
        gateway_id: str | None = None,
        node: str | None = None,
        reuse_port: bool = False,
    ) -> None:
        self.config = config
        self.registry = registry or TypeRegistry()
        self.gateway_id = gateway_id or os.urandom(8).hex()
        self.hubs: dict[str, Hub] = {}
        self.servers: list[RosbridgeServer] = []
        self.remotes: list[Remote] = []
        self.node: OverlayNode | None = None
        self.store: Store | None = None
        self.budget = config.gateway.budget()
        self.nodes: Nodes | None = None
        self._node = node or config.gateway.name
        self._reuse_port = reuse_port
        self._stack = AsyncExitStack()
        self._tls: ssl.SSLContext | None = None
        self._trusted = b""
        self._entrance = Entrance()
        self._watch = RouteWatch(lambda: self.remotes)

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
            graph = await open_network(network, registry=self.registry, name=self._node, gateway_id=self.gateway_id)
            stack.push_async_callback(graph.close)
            hub = self.hubs[url] = Hub(graph, gateway_id=self.gateway_id)
            await hub.open()
            stack.push_async_callback(hub.close)
        if settings.listen:
            nodes = settings.iort.max_nodes if any(map(is_iort, settings.listen)) else 0
            room = make_room(settings.clients.max_clients + nodes)
            self._entrance.set_room(clients=room.clients, pending=room.pending)
        if self.config.stores:
            self.store = await self._open_store(stack)
        limits = Limits(max_message_bytes=settings.max_message_bytes, budget=self.budget)
        await self._bring_up_server(stack, limits)
        await self._bring_up_nodes(stack)
        await self._bring_up_remotes(stack, limits)
        stack.push_async_callback(Supervised(self._update_meters, "gateway meters").start().close)
        stack.push_async_callback(Supervised(self._watch.run, "gateway routes").start().close)

    async def _bring_up_server(self, stack: AsyncExitStack, limits: Limits) -> None:
        """Listen for rosbridge clients and gateways."""
        settings = self.config.gateway
        links = [url for url in settings.listen if not is_iort(url)]
        if not links:
            return
        from ropeway.listener.store_pages import StorePages
        from ropeway.networks.rosbridge.server import RosbridgeServer  # a gateway that only dials does not need it

        server = RosbridgeServer(
            self.hubs[settings.graphs[0]],
            self.registry,
            gateway_id=self.gateway_id,
            name=settings.name,
            node=self._node,
            limits=limits,
            entrance=self._entrance,
            reasons=self.missing,
            unregister_timeout_s=settings.clients.unregister_timeout_s,
            call_timeout_s=settings.clients.call_timeout_s,
            params_timeout_s=settings.clients.params_timeout_s,
            silence_s=settings.clients.silence_s,
            ping_interval_s=settings.clients.ping_interval_s,
            cancel_goals=settings.clients.cancel_goals,
            publish_clients=settings.clients.publish_clients,
            publish_rosout=settings.clients.publish_rosout,
            pages=None if self.store is None else StorePages(self.store, self.registry),
        )
        stack.push_async_callback(server.close)
        self.servers.append(server)
        for url in links:
            secure = self._tls if is_secure(url) else None
            address = url + settings.clients.path.removesuffix("/")
            await server.listen(address, ssl_context=secure, reuse_port=self._reuse_port)
            if settings.auth.tokens and not is_secure(url) and not is_loopback(url):
                log.warning("%s: tokens are sent unencrypted here; wss:// would encrypt them", url)

    async def _open_store(self, stack: AsyncExitStack) -> Store:
        from ropeway.store import Store, default_path, make_backend, make_mirror

        config = self.config.gateway.store or StoreConfig.model_validate({})
        mirror = None if config.mongodb is None else make_mirror(config.mongodb)
        backend = make_backend(config.path or default_path(self.config.gateway.name))
        store = Store(backend, mirror=mirror, limits=config.limits())
        await store.open()
        stack.push_async_callback(store.close)
        return store

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
            if settings.auth.tokens and not is_secure(url) and not is_loopback(url):
                log.warning("%s: tokens are sent unencrypted here; iorts:// would encrypt them", url)

    async def _bring_up_remotes(self, stack: AsyncExitStack, limits: Limits) -> None:
        dialler = Dialler(self.registry, self.gateway_id, self.config.gateway.name, limits)
        routes: dict[int, list[Route]] = {}
        for route in self.config.routes():
            routes.setdefault(id(route.remote), []).append(route)
        for index, config in enumerate(self.config.remotes):
            mine = routes.get(id(config), [])
            if not config.active or not (mine or config.automatic):
                continue
            remote: Remote
            group: GroupRemote | None = None
            if config.address == OVERLAY and config.anycast is not None:
                remote = group = self._overlay_group(config, mine)
            elif config.address == OVERLAY:
                remote = OverlayRemote(config, self._overlay_graph(config))
            elif is_iort(config.address):
                remote = self._iort_remote(config, index)
            elif len(config.addresses) > 1:
                remote = group = self._group(config, index, mine, dialler)
            elif len(config.interfaces) > 1:
                remote = self._links(config, index, mine, dialler)
            else:
                remote = self._link(config, index, mine, dialler)
            await remote.graph.open()
            stack.push_async_callback(remote.graph.close)
            self.remotes.append(remote)
            views: dict[str, View] = {}
            for route in mine:
                view = self._view(stack, views, route.graph, config)
                view.hub.advisers[remote.graph] = None
                bridge = make_bridge(route, view, remote.graph, self._keeper(route))
                await bridge.start()
                stack.push_async_callback(bridge.close)
                remote.running[route.key] = RunningRoute(route, bridge)
            if group is not None:
                await group.listen(self._view(stack, views, config.graph or self.config.gateway.graphs[0], config))
                stack.push_async_callback(group.close)
            if config.automatic is not None and isinstance(remote, OverlayRemote):
                from ropeway.gateway.automatic import Automatic

                url = config.graph or self.config.gateway.graphs[0]
                view = self._view(stack, views, url, config)
                remote.automatic = Automatic(view, remote.graph, config, f"remotes[{index}].automatic", url)
                await remote.automatic.start()
                stack.push_async_callback(remote.automatic.close)

    def _view(self, stack: AsyncExitStack, views: dict[str, View], url: str, config: RemoteConfig) -> View:
        view = views.get(url)
        if view is None:
            view = views[url] = self.hubs[url].view(shown_address(config))
            stack.push_async_callback(view.close)
        return view

    def _keeper(self, route: Route) -> LastValue | None:
        if not route.store:
            return None
        assert self.store is not None
        from ropeway.gateway.last_value import LastValue, key_of

        return LastValue(self.store, *key_of(route.name, self.config.gateway.name), route.type)

    def _iort_remote(self, config: RemoteConfig, index: int) -> IortRemote:
        from ropeway.networks.iort.graph import IortGraph
        from ropeway.networks.iort.links import RemoteLink
        from ropeway.networks.iort.maps import Maps

        shown = read_credentials(config, index)
        name = self.config.gateway.name
        link = RemoteLink(config.address, name, token=shown.token, ssl_context=shown.context, wait_s=0.0)
        maps = Maps([item.as_map() for item in config.maps])
        return IortRemote(config, IortGraph(link, name=config.address, maps=maps, registry=self.registry), link, shown)

    def _link(self, config: RemoteConfig, index: int, routes: list[Route], dialler: Dialler) -> LinkRemote:
        shown = read_credentials(config, index)
        graph = dialler.graph(config, config.address, shown, watch=fetch(routes))
        return LinkRemote(config, graph, shown, make_onlooker=lambda: self._onlooker(config, index, dialler))

    def _onlooker(self, config: RemoteConfig, index: int, dialler: Dialler) -> InterfaceGraph:
        shown = read_credentials(config, index)
        return dialler.graph(config, config.address, shown, watch=True, looks_on=True)

    def _group(self, config: RemoteConfig, index: int, routes: list[Route], dialler: Dialler) -> GroupRemote:
        from ropeway.gateway.group import LinkGroupRemote  # most gateways have no group

        shown = read_credentials(config, index)
        graphs = (dialler.graph(config, url, shown, watch=fetch(routes)) for url in config.addresses)
        links = {graph.name: graph for graph in graphs}
        return LinkGroupRemote(config, links, routes, self.registry, shown, self.config.gateway.name)

    def _links(self, config: RemoteConfig, index: int, routes: list[Route], dialler: Dialler) -> Remote:
        from ropeway.gateway.links import LinksRemote  # most gateways have one link

        shown = read_credentials(config, index)
        watch = fetch(routes)
        links = {
            name: dialler.graph(config, config.address, shown, watch=watch, interface=name)
            for name in config.interfaces
        }
        return LinksRemote(config, links, self.registry, shown)

    def _overlay_group(self, config: RemoteConfig, routes: list[Route]) -> GroupRemote:
        from ropeway.gateway.group import OverlayGroupRemote

        return OverlayGroupRemote(config, self._overlay_graph(config), routes, self.registry, self.config.gateway.name)

    def _overlay_graph(self, config: RemoteConfig) -> OverlayGraph:
        require("overlay", "the overlay")
        from ropeway.networks.overlay.crypto.identity import Identity
        from ropeway.networks.overlay.graph import OverlayGraph  # loads Zenoh, which others do not need
        from ropeway.networks.overlay.names import Metadata
        from ropeway.networks.overlay.node import OverlayNode

        settings = self.config.gateway.overlay
        assert settings is not None
        if self.node is None:
            self.node = OverlayNode(
                Identity.load(settings.identity),
                routers=settings.routers,
                listen=settings.listen,
                max_message_bytes=self.config.gateway.max_message_bytes,
            )
        about = Metadata(settings.author, settings.maintainer, settings.description, config.unique or "", settings.node)
        everybody = ("*",)
        return OverlayGraph(
            self.node,
            metadata=about,
            readers=everybody if config.readers is None else config.readers,
            callers=everybody if config.callers is None else config.callers,
            registry=self.registry,
            node_name=self._node,
        )

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
        up = sum(len(server.listeners) for server in self.servers)
        up += 0 if self.nodes is None else len(self.nodes.server.listeners)
        if up < len(settings.listen):
            reasons.append(f"{up} of {len(settings.listen)} listeners are up")
        return reasons

    def reload(self) -> None:
        """Read certificates and tokens again, for connections to come; clients whose token is gone are disconnected.

        So is who showed a certificate, if other authorities are trusted now, and a link to a remote, if others are
        trusted there. Raises ``ConfigError`` if the files are no good; everything then stays as it was.
        """
        settings = self.config.gateway
        shown = [read_credentials(remote.config, index) for index, remote in enumerate(self.remotes)]
        door, context, trusted = make_door(settings), server_context(settings.tls), trusted_files(settings.tls)
        certificates = trusted != self._trusted
        self._entrance.door, self._tls, self._trusted = door, context, trusted
        for server in self.servers:
            _renew(server.listeners, context)
            server.recheck(certificates=certificates)
        if self.nodes is not None:
            _renew(self.nodes.server.listeners, context)
            self.nodes.server.recheck()
        for remote, credentials in zip(self.remotes, shown, strict=True):
            remote.renew(credentials)
        log.info("%s has read its certificates and tokens again", settings.name)

    def routes(self) -> list[RouteStatus]:
        """Return how every route is."""
        return [row for remote in self.remotes for row in remote.routes()]

    async def ask(self, question: Question, params: Mapping[str, Any]) -> list[Any]:
        """Return the answer to a question as the only one in a list, as a ``Supervisor`` has one of each worker."""
        return [await question(self, params)]

    async def explain(self, name: str, to: str = "") -> list[Explanation]:
        """Explain why a name crosses to a remote or does not; see ``ropeway.gateway.explain``."""
        return await explain(self.remotes, name, to)

    def status(self) -> dict[str, Any]:
        """Return the state of everything as JSON."""
        return {
            "name": self.config.gateway.name,
            "graphs": [
                {
                    "graph": url,
                    "topics": len(hub.graph.topics()),
                    "nodes": len(hub.graph.nodes()),
                    "duplicates": sum(hub.duplicates.values()),
                    **({"distro": hub.graph.distro} if isinstance(hub.graph, Distributed) and hub.graph.distro else {}),
                    "drops": {f"{topic}: {why.value}": n for (topic, why), n in hub.graph.drops.items() if n},
                }
                for url, hub in self.hubs.items()
            ],
            "listen": [
                {"address": listener.address, "port": listener.port, "clients": len(server.sessions)}
                for server in self.servers
                for listener in server.listeners
            ],
            "remotes": [remote.status() for remote in self.remotes],
            "routes": [row.to_json() for row in self.routes()],
            "memory": self.budget.status(),
            "access": summed([self._entrance.status(), *(server.status() for server in self.servers)]),
            "sessions": [session.status() for server in self.servers for session in server.sessions],
            **({} if self.store is None else {"store": self.store.status()}),
            **({} if self.nodes is None else {"nodes": self.nodes.status()}),
            "failed": failing(),
        }

    async def wait(self) -> None:
        """Run until cancelled."""
        await asyncio.Event().wait()


def _renew(listeners: Iterable[Listener], context: ssl.SSLContext | None) -> None:
    for listener in listeners:
        if listener.context is not None:
            listener.context = context
