"""Members of the overlay, in this process."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.node import OverlayNode
from ropeway.networks.overlay.router import Router
from tests.networks.overlay.fleet import fleet, member
from tests.support.ports import free_endpoint
from tests.support.until import until

Join = Callable[..., Awaitable[OverlayGraph]]


class Site:
    """A router, and members that are linked with it."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.endpoint = free_endpoint()
        self.graphs: list[OverlayGraph] = []
        self.router: Router

    async def start(self, **options: Any) -> None:
        identity = member("router", role="router")
        self.router = Router(identity, listen=[self.endpoint], look_s=0.2, **options)
        await self.stack.enter_async_context(self.router)

    async def join(self, identity: Identity | None = None, *, alone: bool = False, **options: Any) -> OverlayGraph:
        """One more member; waits until all know each other, unless it is to be left alone."""
        node_options = {
            key: options.pop(key)
            for key in ("policy", "rotate_s", "max_message_bytes", "sessions", "clock_ns")
            if key in options
        }
        node = OverlayNode(identity or member(), routers=[self.endpoint], listen=(), **node_options)
        graph = OverlayGraph(node, **options)
        await graph.open()
        self.stack.push_async_callback(graph.close)
        if not alone:
            self.graphs.append(graph)
            await until(lambda: all(len(g.node.membership.gateways()) >= len(self.graphs) - 1 for g in self.graphs))
        return graph


@pytest.fixture
async def site() -> AsyncIterator[Site]:
    """A router of the fleet, and a way to join."""
    fleet()
    async with AsyncExitStack() as stack:
        made = Site(stack)
        await made.start()
        yield made
