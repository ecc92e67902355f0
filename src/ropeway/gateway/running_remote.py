"""A remote of a running gateway with its routes, each of which can come and go while the others run."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterable
from contextlib import AsyncExitStack
from typing import Final, Protocol

from ropeway.bridge.topic import TopicBridge
from ropeway.gateway.bridges import RouteHost, bridge_options, fetch, make_bridge
from ropeway.gateway.config.config import Config, Route
from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.remote import OverlayRemote, Remote, shown_address
from ropeway.gateway.route import RunningRoute
from ropeway.hub.hub import Hub, View
from ropeway.tasks import describe

__all__ = ["RemoteHost", "RunningRemote"]

log = logging.getLogger("ropeway.gateway")

_FINISH_S: Final = 2.0
"""How long what is under way may take to end, when its route is taken away."""


class RemoteHost(RouteHost, Protocol):
    """Has what the routes of a remote use; ``Gateway`` is one."""

    config: Config
    hubs: dict[str, Hub]


class RunningRemote:
    """A remote that is up, with the views of local graphs that its routes use; ``close`` ends all that it began."""

    def __init__(self, host: RemoteHost, remote: Remote, index: int, *, default_graph: str) -> None:
        self.remote, self.index = remote, index
        self._host = host
        self._graph = remote.config.graph or default_graph
        self._stack = AsyncExitStack()
        self._views: dict[str, View] = {}

    @property
    def config(self) -> RemoteConfig:
        """The configuration of the remote."""
        return self.remote.config

    async def open(self, routes: Iterable[Route]) -> None:
        """Begin to reach the remote, and start its routes. Nothing stays up if that fails."""
        remote = self.remote
        try:
            await remote.graph.open()
            self._stack.push_async_callback(remote.graph.close)
            for route in routes:
                await self.add(route)
            await self._begin_group()
            await self._begin_automatic()
        except BaseException:
            await self.close()
            raise

    async def add(self, route: Route) -> None:
        """Start a route."""
        if fetch([route]):
            self.remote.begin_watch()
        view = self._view(route.graph)
        view.hub.advisers[self.remote.graph] = None
        bridge = make_bridge(route, view, self.remote.graph, bridge_options(route, self._host))
        await bridge.start()
        self.remote.running[route.key] = RunningRoute(route, bridge)

    async def remove(self, key: str) -> None:
        """End a route: what is under way has a moment to end."""
        running = self.remote.running.pop(key)
        await running.bridge.finish(_FINISH_S)
        await running.bridge.close()

    async def change(self, route: Route) -> None:
        """Carry a route of the same key out in another way; messages go on, calls that take longer end."""
        running = self.remote.running.get(route.key)
        if running is not None and isinstance(running.bridge, TopicBridge):
            await running.bridge.change(bridge_options(route, self._host))
            running.route = route
            return
        if running is not None:
            await self.remove(route.key)
        await self.add(route)

    def renumber(self, config: RemoteConfig, index: int, routes: Iterable[Route]) -> None:
        """Take the place that the configuration now has the remote and its routes at, in this order."""
        self.remote.config, self.index = config, index
        running = self.remote.running
        for route in routes:
            there = running.pop(route.key)
            there.route = route
            running[route.key] = there

    async def finish(self) -> None:
        """Let what is under way end, for a moment."""
        await asyncio.gather(*(running.bridge.finish(_FINISH_S) for running in self.remote.running.values()))

    async def close(self) -> None:
        """End the routes and leave the remote."""
        running, self.remote.running = dict(self.remote.running), {}
        for there in running.values():
            try:
                await there.bridge.close()
            except Exception as error:  # of a graph that is going: the others end all the same
                log.warning("%s did not end in order: %s", there.route.name, describe(error), exc_info=error)
        for view in self._views.values():
            view.hub.advisers.pop(self.remote.graph, None)
        await self._stack.aclose()

    def _view(self, url: str) -> View:
        view = self._views.get(url)
        if view is None:
            view = self._views[url] = self._host.hubs[url].view(shown_address(self.config))
            self._stack.push_async_callback(view.close)
        return view

    async def _begin_group(self) -> None:
        if self.remote.listens:
            await self.remote.listen(self._view(self._graph))
            self._stack.push_async_callback(self.remote.close)

    async def _begin_automatic(self) -> None:
        remote = self.remote
        if self.config.automatic is None or not isinstance(remote, OverlayRemote):
            return
        from ropeway.gateway.automatic import Automatic

        view, path = self._view(self._graph), f"remotes[{self.index}].automatic"
        remote.automatic = Automatic(view, remote.graph, self.config, path, self._graph, self._host)
        await remote.automatic.start()
        self._stack.push_async_callback(remote.automatic.close)
