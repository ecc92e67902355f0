"""A rosbridge server on a network of its own, and clients of it, as fixtures that several folders import."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.hub.hub import Hub
from ropeway.listener.authentication import Door
from ropeway.listener.connection import Limits
from ropeway.listener.entrance import Entrance
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.server import RosbridgeServer
from ropeway.networks.rosbridge.server.session import Session
from ropeway.types import TypeRegistry
from tests.support.websocket import Client

__all__ = ["Place", "bare", "place"]

_numbers = itertools.count()
_registry = TypeRegistry()


class Place:
    """The server, and a robot's participant on its network."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.registry = _registry
        self.network = f"server-{next(_numbers)}"
        self.server: RosbridgeServer
        self.hub: Hub
        self.robot: MemoryGraph
        self.port = 0

    async def start(
        self,
        *,
        limits: Limits | None = None,
        unregister_timeout_s: float = 10.0,
        door: Door | None = None,
        **options: Any,
    ) -> None:
        self.entrance = Entrance(door)
        graph = await self.participant("/gateway")
        self.robot = await self.participant("/robot")
        self.hub = Hub(graph)
        self.server = RosbridgeServer(
            self.hub,
            self.registry,
            limits=limits,
            unregister_timeout_s=unregister_timeout_s,
            entrance=self.entrance,
            **options,
        )
        self.stack.push_async_callback(self.server.close)
        self.port = (await self.server.listen("ws://127.0.0.1:0")).port

    async def participant(self, node: str) -> MemoryGraph:
        graph = MemoryGraph(self.network, node=node)
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph

    async def client(self, **options: Any) -> Client:
        return await self.stack.enter_async_context(Client(self.port, **options))

    @property
    def session(self) -> Session:
        """The one client's session."""
        (session,) = self.server.sessions
        return session

    @property
    def complaints(self) -> dict[str, int]:
        """What all clients did wrong: how often by kind."""
        out: dict[str, int] = {}
        for session in self.server.sessions:
            for (kind, _), n in session.peer.fault_log.counts.items():
                out[kind] = out.get(kind, 0) + n
        return out


@pytest.fixture
async def bare() -> AsyncIterator[Place]:
    """A place whose server a test starts itself."""
    async with AsyncExitStack() as stack:
        yield Place(stack)


@pytest.fixture
async def place(bare: Place) -> Place:
    """A server that is up."""
    await bare.start(unregister_timeout_s=0.1)
    return bare
