"""A link to a gateway by one network interface, which is one of several to the same gateway."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from ropeway.listener.connection import Connection
from ropeway.listener.websocket import connect
from ropeway.networks.rosbridge.client.graph import RosbridgeGraph
from ropeway.networks.rosbridge.link.peer import Peer
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY

__all__ = ["InterfaceGraph"]


class InterfaceGraph(RosbridgeGraph):
    """The graph behind ``url``, reached by ``interface``: its name, an address that it has, or ``""`` for whichever the
    system takes.
    """

    def __init__(self, url: str, interface: str, **options: Any) -> None:
        super().__init__(url, dial=partial(connect, interface=interface), **options)
        self.interface = interface
        self.one_of_several = True
        if interface:
            self.name = f"{self.name} by {interface}"
        self._told: list[Callable[[float], None]] = []

    @property
    def numbers(self) -> bool:
        """Whether the far side is a gateway, whose messages have numbers."""
        return self.peer is not None and self.peer.dialect is ROPEWAY

    def probe(self) -> None:
        """Ask for a sign of life, if the link is up."""
        if self.peer is not None:
            self.peer.ping()

    def on_probe(self, callback: Callable[[float], None]) -> None:
        """Call with the round trip of each probe, in seconds."""
        self._told.append(callback)

    async def _converse(self, connection: Connection, peer: Peer) -> None:
        peer.on_round_trip = self._came
        await super()._converse(connection, peer)

    def _came(self, round_trip_s: float) -> None:
        for callback in self._told:
            callback(round_trip_s)
