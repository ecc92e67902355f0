"""A Ropeway gateway that a test plays, as the server of a link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ropeway.listener.connection import Connection, Limits
from ropeway.listener.listener import Listener
from ropeway.listener.websocket import listen
from ropeway.networks.rosbridge.link.peer import Peer
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY_SUBPROTOCOL
from ropeway.networks.rosbridge.protocol.records import Arrival
from ropeway.types import TypeRegistry
from tests.support.until import until

__all__ = ["ScriptedGateway"]


class ScriptedGateway:
    """Keeps what a gateway says, and says what it is told to."""

    def __init__(self, registry: TypeRegistry) -> None:
        self.registry = registry
        self.peers: list[Peer] = []
        self.heard: list[ops.Op] = []
        self.controls: list[Mapping[str, Any]] = []
        self.greets = True
        self.port = 0
        self._server: Listener | None = None

    async def start(self) -> None:
        """Listen, at the same port as before."""
        self._server = await listen(
            "127.0.0.1", self.port, self._accept, limits=Limits(), subprotocols=(ROPEWAY_SUBPROTOCOL,)
        )
        self.port = self._server.port

    def _accept(self, connection: Connection) -> None:
        peer = Peer(connection, self.registry, self)
        self.peers.append(peer)
        if self.greets:
            peer.hello("scripted", "scripted")

    async def stop(self) -> None:
        """Vanish."""
        if self._server is not None:
            await self._server.close()
        for peer in self.peers:
            peer.connection.abort("gone")
        await until(lambda: all(p.connection.closed for p in self.peers))

    @property
    def url(self) -> str:
        return f"ws://127.0.0.1:{self.port}"

    @property
    def peer(self) -> Peer:
        """The last that connected."""
        return self.peers[-1]

    def show(self, **tables: Any) -> None:
        """Tell what there is in our graph."""
        self.peer.send({"op": "graph", "topics": {}, "nodes": {}, "services": {}, "actions": {}, **tables})

    async def hear(self, op: str, count: int = 1) -> list[Any]:
        """Wait for so many operations of a kind; gives all of them."""
        await until(lambda: len([o for o in self.heard if o.op == op]) >= count)
        return [o for o in self.heard if o.op == op]

    async def hear_control(self, op: str, count: int = 1) -> list[Mapping[str, Any]]:
        """Wait for so many messages between gateways; gives all of them."""
        await until(lambda: len([m for m in self.controls if m["op"] == op]) >= count)
        return [m for m in self.controls if m["op"] == op]

    # ── the handler of the peer ────────────────────────────────────────────────────────────────────────────────

    def operation(self, op: ops.Op) -> None:
        self.heard.append(op)

    def control(self, message: Mapping[str, Any]) -> None:
        self.controls.append(message)

    def arrived(self, channel: int, arrivals: Sequence[Arrival]) -> None:
        raise AssertionError("topics are not expected")

    def takes(self, channel: int) -> bool:
        return False

    def lost(self, code: int, reason: str) -> None:
        pass
