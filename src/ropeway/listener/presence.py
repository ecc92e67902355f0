"""Publishes who is connected, as rosbridge does: ``/client_count`` and ``/connected_clients``."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, Any, Final

from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.qos import LATCHED

if TYPE_CHECKING:
    from ropeway.graph.base import Graph, Publisher
    from ropeway.types import TypeRegistry

__all__ = ["COUNT_TYPE", "LIST_TYPE", "Presence", "ip_address"]

COUNT_TYPE: Final = "std_msgs/msg/Int32"
LIST_TYPE: Final = "rosbridge_msgs/msg/ConnectedClients"


class Presence:
    """Publishes the number and the addresses of the clients, latched, at each change.

    Changes that come together are told once. ``namespace`` goes before the names of the two topics.
    """

    def __init__(
        self,
        graph: Graph,
        registry: TypeRegistry,
        *,
        namespace: str = "/",
        clock: Callable[[], int] = time.time_ns,
    ) -> None:
        self._graph, self._clock = graph, clock
        self._namespace = namespace.rstrip("/")
        self._count, self._list = registry.codec(COUNT_TYPE), registry.codec(LIST_TYPE)
        self._clients: dict[Hashable, dict[str, Any]] = {}
        self._publishers: tuple[Publisher, Publisher] | None = None
        self._origin = new_origin()
        self._telling: asyncio.Handle | None = None

    async def open(self) -> None:
        """Publish the topics. Raises what ``Graph.create_publisher`` raises; nothing is published then."""
        count = await self._graph.create_publisher(f"{self._namespace}/client_count", COUNT_TYPE, LATCHED)
        try:
            clients = await self._graph.create_publisher(f"{self._namespace}/connected_clients", LIST_TYPE, LATCHED)
        except BaseException:
            await count.close()
            raise
        self._publishers = count, clients
        self._tell()

    def joined(self, client: Hashable, address: str) -> None:
        """Add a client that has connected from ``address``."""
        sec, nanosec = divmod(self._clock(), 1_000_000_000)
        self._clients[client] = {"ip_address": address, "connection_time": {"sec": sec, "nanosec": nanosec}}
        self._changed()

    def left(self, client: Hashable) -> None:
        """Remove a client that has gone."""
        if self._clients.pop(client, None) is not None:
            self._changed()

    def _changed(self) -> None:
        if self._publishers is not None and self._telling is None:
            self._telling = asyncio.get_running_loop().call_soon(self._tell)

    def _tell(self) -> None:
        self._telling = None
        if self._publishers is None:
            return
        clients = list(self._clients.values())
        now = self._clock()
        count, listed = self._publishers
        count.publish(Sample(self._count.encode({"data": len(clients)}), COUNT_TYPE, now, self._origin, SEQ_NONE))
        listed.publish(Sample(self._list.encode({"clients": clients}), LIST_TYPE, now, self._origin, SEQ_NONE))

    async def close(self) -> None:
        """Withdraw the topics; what was not told yet is."""
        if self._telling is not None:
            self._telling.cancel()
            self._tell()
        publishers, self._publishers = self._publishers, None
        for publisher in publishers or ():
            await publisher.close()


def ip_address(peer: str) -> str:
    """Return the address without the port: ``192.168.1.7`` for ``192.168.1.7:40222``, ``::1`` for ``[::1]:40222``."""
    host, colon, port = peer.rpartition(":")
    if not colon or not port.isdigit() or (":" in host and not host.startswith("[")):
        host = peer
    return host.removeprefix("[").removesuffix("]")
