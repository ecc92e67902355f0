"""Presents one gateway of the overlay as a graph of its own, so that several can be a group."""

from __future__ import annotations

from collections.abc import Callable

from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.graph.graph import OverlayGraph

__all__ = ["MemberGraph"]


class MemberGraph(OverlayGraph):
    """Presents one gateway of the overlay: nobody else gets or gives anything here.

    It is used over the graph ``through``, whose sender it shares. Whether its gateway is ``reached`` is for others to
    say.
    """

    def __init__(self, through: OverlayGraph, gateway: bytes, name: str) -> None:
        super().__init__(
            through.node,
            metadata=through.metadata,
            readers=through.patterns["subscribe"],
            callers=through.patterns["call"],
            registry=through.registry,
            label=name,
            node_name=through.node_name,
        )
        self.target = gateway
        self._through = through
        self._reached = False
        self._reach_callbacks: list[Callable[[bool], None]] = []

    async def _join(self) -> None:
        await self.node.open()
        self.sender = self._through.sender
        self._stop = self.node.rib.on_change(self._changed_there)

    async def _leave(self) -> None:
        if self._stop is not None:
            self._stop()
        await self.node.close()

    def _changed_there(self, advert: Advertisement, added: bool) -> None:
        if advert.gateway == self.target:
            self._changed(advert, added)

    def _all(self, *kinds: str) -> list[Advertisement]:
        return [advert for advert in super()._all(*kinds) if advert.gateway in (self.target, self.node.gateway)]

    def on_reached(self, callback: Callable[[bool], None]) -> None:
        """Call with whether the gateway is reached, now and at each change."""
        self._reach_callbacks.append(callback)
        callback(self._reached)

    def set_reached(self, reached: bool) -> None:
        """Note whether the gateway is reached."""
        if reached != self._reached:
            self._reached = reached
            for callback in self._reach_callbacks:
                callback(reached)
