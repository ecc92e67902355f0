"""Rosbridge servers: one that a test plays, and a real one that goes and comes back."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import AsyncExitStack
from typing import Any, Final

from ropeway.hub.hub import Hub
from ropeway.listener.connection import Connection, Limits
from ropeway.listener.listener import Listener
from ropeway.listener.websocket import listen
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.server import RosbridgeServer
from ropeway.types import TypeRegistry
from tests.support.until import until

__all__ = ["FAST", "REGISTRY", "Cloud", "FakeServer"]

REGISTRY: Final = TypeRegistry()
FAST: Final = Limits(ping_interval_s=0.05, silence_s=0.3)


class FakeServer:
    """A server that a test plays: keeps what clients say, and says what it is told to."""

    def __init__(self) -> None:
        self.connections: list[Connection] = []
        self.heard: list[dict[str, Any]] = []
        self.binaries: list[bytes] = []
        self.on_connection: Callable[[Connection], None] = lambda _: None
        self._server: Listener | None = None
        self.port = 0

    async def start(self, *, subprotocols: tuple[str, ...] = (), limits: Limits | None = None) -> None:
        self._server = await listen(
            "127.0.0.1", self.port, self._accept, limits=limits or Limits(), subprotocols=subprotocols
        )
        self.port = self._server.port

    def _accept(self, connection: Connection) -> None:
        self.connections.append(connection)
        connection.on_text = lambda data: self.heard.append(json.loads(data))
        connection.on_binary = lambda data: self.binaries.append(bytes(data))
        self.on_connection(connection)

    async def stop(self) -> None:
        """Vanish."""
        if self._server is not None:
            await self._server.close()
        for connection in self.connections:
            connection.abort("gone")
        await until(lambda: all(c.closed for c in self.connections))

    def ops(self, op: str) -> list[dict[str, Any]]:
        return [m for m in self.heard if m.get("op") == op]

    def say(self, message: dict[str, Any]) -> None:
        self.connections[-1].send_text(json.dumps(message).encode())

    @property
    def url(self) -> str:
        return f"ws://127.0.0.1:{self.port}"


class Cloud:
    """A real server on a network of its own, which can go and come back."""

    def __init__(self, network: str, limits: Limits = FAST) -> None:
        self.network, self.limits = network, limits
        self.port = 0
        self._stack = AsyncExitStack()

    async def start(self) -> None:
        graph = MemoryGraph(self.network, node="/cloud")
        await graph.open()
        self._stack.push_async_callback(graph.close)
        self.server = RosbridgeServer(Hub(graph), REGISTRY, gateway_id="the cloud", name="cloud", limits=self.limits)
        self._stack.push_async_callback(self.server.close)
        self.port = (await self.server.listen(f"ws://127.0.0.1:{self.port}")).port

    async def stop(self) -> None:
        await self._stack.aclose()
