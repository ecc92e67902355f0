"""A gateway in this process: brings a configuration up as the paper's Algorithm 1 has it, and takes it down."""

from __future__ import annotations

import asyncio
import logging
import os
import ssl
from contextlib import AsyncExitStack
from typing import Any, Final

from ropeway.bridge.action import ActionBridge
from ropeway.bridge.service import ServiceBridge
from ropeway.bridge.topic import TopicBridge
from ropeway.gateway.address import is_loopback, is_secure
from ropeway.gateway.allocator import keep_freed_memory
from ropeway.gateway.auth import make_door, read_secret
from ropeway.gateway.config import Config, Route
from ropeway.gateway.counts import summed
from ropeway.gateway.model import RemoteConfig
from ropeway.gateway.tls import client_context, reload_server_context, server_context
from ropeway.graph.factory import open_graph
from ropeway.graph.hub import Hub, View
from ropeway.graph.rosbridge import LinkState, RosbridgeGraph
from ropeway.link.connection import Limits
from ropeway.server import RosbridgeServer
from ropeway.tasks import end
from ropeway.types import TypeRegistry

__all__ = ["Gateway"]

log = logging.getLogger("ropeway.gateway")

_METERS_S: Final = 1.0

_NEED_DISCOVERY: Final = ("subscribe", "reserve-service", "reserve-action")  # what is there matters

Bridge = TopicBridge | ServiceBridge | ActionBridge


class Remote:
    """One remote: its link and the bridges over it."""

    def __init__(self, config: RemoteConfig, graph: RosbridgeGraph) -> None:
        self.config, self.graph = config, graph
        self.bridges: list[tuple[Route, Bridge]] = []

    def status(self) -> dict[str, Any]:
        """The link, for people and programs."""
        peer = self.graph.peer
        bytes_in, bytes_out = self.graph.traffic
        pace = peer.connection.flow.pace.bytes_per_s if peer is not None else None
        return {
            "address": self.config.address,
            "title": self.config.title,
            "state": self.graph.state.value,
            "error": self.graph.last_error,
            "gateway": self.graph.remote.get("name", ""),
            "connections": self.graph.connections,
            "rtt_ms": None if peer is None or peer.rtt_s is None else round(1e3 * peer.rtt_s, 3),
            "pace_bps": None if pace is None else round(8 * pace),
            "bytes_in": bytes_in,
            "bytes_out": bytes_out,
            "complaints": {}
            if peer is None
            else {f"{kind} {topic}".strip(): n for (kind, topic), n in peer.complaints.counts.items()},
        }


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
        self._node = node or config.gateway.name
        self._reuse_port = reuse_port
        self._stack = AsyncExitStack()
        self._tls: ssl.SSLContext | None = None
        self._failed: asyncio.Future[None] | None = None

    async def __aenter__(self) -> Gateway:
        """Bring everything up. Raises ``RopewayError`` if a graph or a listener cannot be had; nothing stays up."""
        async with AsyncExitStack() as stack:
            self._failed = asyncio.get_running_loop().create_future()
            await self._bring_up(stack)
            self._stack = stack.pop_all()
        return self

    async def __aexit__(self, *_: object) -> None:
        """Take everything down, in the opposite order."""
        await self._stack.aclose()

    async def _bring_up(self, stack: AsyncExitStack) -> None:
        keep_freed_memory()
        settings = self.config.gateway
        for path in settings.types:
            self.registry.add_path(path)
        self.registry.add_ament_prefix_path()
        door = make_door(settings)
        self._tls = server_context(settings.tls)
        for url in settings.graphs:
            graph = await open_graph(url, registry=self.registry, name=self._node, gateway_id=self.gateway_id)
            stack.push_async_callback(graph.close)
            hub = self.hubs[url] = Hub(graph, gateway_id=self.gateway_id)
            await hub.open()
            stack.push_async_callback(hub.close)
        limits = Limits(max_message_bytes=settings.max_message_bytes)
        if settings.listen:
            server = RosbridgeServer(
                self.hubs[settings.graphs[0]],
                self.registry,
                gateway_id=self.gateway_id,
                name=settings.name,
                limits=limits,
                door=door,
                reasons=self.missing,
                unregister_timeout_s=settings.clients.unregister_timeout_s,
                call_timeout_s=settings.clients.call_timeout_s,
                params_timeout_s=settings.clients.params_timeout_s,
                silence_s=settings.clients.silence_s,
                ping_interval_s=settings.clients.ping_interval_s,
                cancel_goals=settings.clients.cancel_goals,
                publish_clients=settings.clients.publish_clients,
                publish_rosout=settings.clients.publish_rosout,
            )
            stack.push_async_callback(server.close)
            self.servers.append(server)
            for url in settings.listen:
                secure = self._tls if is_secure(url) else None
                address = url + settings.clients.path.removesuffix("/")
                await server.listen(address, ssl_context=secure, reuse_port=self._reuse_port)
                if settings.auth.tokens and not is_secure(url) and not is_loopback(url):
                    log.warning("%s: tokens travel in clear here; wss:// would hide them", url)
        await self._bring_up_remotes(stack, limits)
        meters = asyncio.create_task(self._update_meters(), name="gateway meters")
        stack.push_async_callback(end, meters)

    async def _bring_up_remotes(self, stack: AsyncExitStack, limits: Limits) -> None:
        routes: dict[int, list[Route]] = {}
        for route in self.config.routes():
            routes.setdefault(id(route.remote), []).append(route)
        for index, remote_config in enumerate(self.config.remotes):
            mine = routes.get(id(remote_config), [])
            if not remote_config.active or not mine:
                continue
            graph = RosbridgeGraph(
                remote_config.address,
                registry=self.registry,
                limits=limits,
                ssl_context=client_context(remote_config.tls, f"remotes[{index}].tls"),
                headers=_credentials(remote_config, f"remotes[{index}].token"),
                gateway_id=self.gateway_id,
                name=self.config.gateway.name,
                wait=False,
                watch=any(r.operation in _NEED_DISCOVERY for r in mine),
                ask_rosapi=False,
            )
            await graph.open()
            stack.push_async_callback(graph.close)
            remote = Remote(remote_config, graph)
            self.remotes.append(remote)
            views: dict[str, View] = {}
            for route in mine:
                view = views.get(route.graph)
                if view is None:
                    view = views[route.graph] = self.hubs[route.graph].view(remote_config.address)
                    stack.push_async_callback(view.close)
                bridge = self._bridge(route, view, graph)
                await bridge.start()
                stack.push_async_callback(bridge.close)
                remote.bridges.append((route, bridge))

    @staticmethod
    def _bridge(route: Route, local: View, remote: RosbridgeGraph) -> Bridge:
        near, far = (local, route.name), (remote, route.remote_name)
        inward = route.operation in ("subscribe", "reserve-service", "reserve-action")
        (source, source_name), (target, target_name) = (far, near) if inward else (near, far)
        if route.kind == "topic":
            return TopicBridge(
                source,
                target,
                source_name,
                target_name,
                route.type,
                qos=route.qos,
                delivery=route.delivery,
                limit=not inward,
            )
        kind = ServiceBridge if route.kind == "service" else ActionBridge
        return kind(
            source,
            target,
            source_name,
            target_name,
            route.type,
            timeout_s=route.timeout_s,
            delivery=route.delivery,
        )

    async def _update_meters(self) -> None:
        while True:
            await asyncio.sleep(_METERS_S)
            for remote in self.remotes:
                for _, bridge in remote.bridges:
                    if isinstance(bridge, TopicBridge):
                        bridge.meter.update()

    def missing(self) -> list[str]:
        """Why the gateway is not ready for clients, in sentences; empty once all graphs and listeners are up."""
        settings = self.config.gateway
        reasons = [f"{url} is not open" for url in settings.graphs if url not in self.hubs]
        up = sum(len(server.listeners) for server in self.servers)
        if up < len(settings.listen):
            reasons.append(f"{up} of {len(settings.listen)} listeners are up")
        return reasons

    def reload(self) -> None:
        """Read certificates and tokens again, for clients to come; who has a token that is gone is closed.

        Raises ``ConfigError`` if they are no good; everything then stays as it was.
        """
        settings = self.config.gateway
        door = make_door(settings)
        if settings.tls is not None and self._tls is not None:
            reload_server_context(self._tls, settings.tls)
        for server in self.servers:
            server.replace_door(door)
        log.info("%s has read its certificates and tokens again", settings.name)

    def status(self) -> dict[str, Any]:
        """Everything as it stands, as JSON."""
        return {
            "name": self.config.gateway.name,
            "graphs": [
                {
                    "graph": url,
                    "topics": len(hub.graph.topics()),
                    "nodes": len(hub.graph.nodes()),
                    "duplicates": sum(hub.duplicates.values()),
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
            "routes": [
                route_status(route, bridge, remote.graph) for remote in self.remotes for route, bridge in remote.bridges
            ],
            "access": summed(server.status() for server in self.servers),
            "sessions": [session.status() for server in self.servers for session in server.sessions],
        }

    async def wait(self) -> None:
        """Run until cancelled; raises what makes the gateway as a whole impossible."""
        assert self._failed is not None
        await self._failed


def _credentials(remote: RemoteConfig, path: str) -> dict[str, str]:
    """The headers that show our token to a remote."""
    if remote.token is None:
        return {}
    if not is_secure(remote.address) and not is_loopback(remote.address):
        log.warning("%s: the token travels in clear; wss:// would hide it", remote.address)
    return {"Authorization": f"Bearer {read_secret(remote.token, path)}"}


def route_status(route: Route, bridge: Bridge, graph: RosbridgeGraph) -> dict[str, Any]:
    """One row of the table of routes."""
    common = {
        "path": route.path,
        "operation": route.operation,
        "name": route.name,
        "remote_name": route.remote_name,
        "address": route.remote.address,
        "type": route.type,
        "state": bridge.state if graph.state is LinkState.CONNECTED else graph.state.value,
    }
    if isinstance(bridge, TopicBridge):
        return common | _topic_status(route, bridge)
    return common | {
        "error": bridge.error or (f"offered by {bridge.taken_by}" if bridge.taken_by else ""),
        "encoding": route.delivery.encoding,
        "requests": sum(bridge.counts.values()),
        "under_way": bridge.under_way,
        "ended": dict(bridge.counts),
        "took_ms": None if bridge.took_s is None else round(1e3 * bridge.took_s, 3),
    }


def _topic_status(route: Route, bridge: TopicBridge) -> dict[str, Any]:
    meter = bridge.meter
    drops: dict[str, int] = {reason.value: n for reason, n in bridge.drops.items() if n}
    delay, encoding = meter.delay_s, route.delivery.encoding
    publisher = bridge.publisher
    channel = getattr(publisher, "channel", None)
    if channel is not None:
        encoding = channel.used
    for reason, n in getattr(publisher, "lost", {}).items():
        if n:
            drops[reason.value] = n
    if delay is None:
        delay = getattr(publisher, "remote_delay_s", None)
    return {
        "error": bridge.error or getattr(publisher, "refused", ""),
        "encoding": encoding,
        "messages": meter.messages,
        "bytes": meter.bytes,
        "rate_hz": round(meter.rate_hz, 2),
        "bandwidth_bps": round(meter.rate_bps),
        "delay_ms": None if delay is None else round(1e3 * delay, 3),
        "drops": drops,
    }
