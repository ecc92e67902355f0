"""Gives services and actions that are served over a link what they have in common."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

from ropeway.networks.rosbridge.client.calls import announced, lane, travelling
from ropeway.networks.rosbridge.client.other_holder import OtherHolder
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY

if TYPE_CHECKING:
    from ropeway.graph.base import Delivery
    from ropeway.networks.rosbridge.client.calls import Calls
    from ropeway.networks.rosbridge.link.peer import Peer

__all__ = ["LinkProvider"]


class LinkProvider:
    """Serves ``name`` on the far graph. It outlives connections: each new one announces it.

    ``kind`` is ``service`` or ``action``, ``parts`` are the messages of its type. ``held`` tells who else holds the
    name.
    """

    kind: ClassVar[str]
    parts: ClassVar[tuple[str, ...]]

    def __init__(self, calls: Calls, name: str, type: str, delivery: Delivery) -> None:
        self.name, self.type, self.delivery = name, type, delivery
        self.id = f"advertise_{self.kind}:{name}:{next(calls.numbers)}"
        self.held = OtherHolder(calls.graph.name, self.kind, name)
        self.closed = False
        self._calls = calls
        self._lane = lane(delivery)
        self._peer: Peer | None = None
        self._asked: str | None = None  # the encoding that the last request asked for

    @property
    def encoding(self) -> str:
        """The encoding of answers, feedback and results."""
        return travelling(self.delivery, self._peer, self._asked)

    @property
    def refused(self) -> str:
        """The reason why the far gateway does not let us serve it now, ``""`` if it does."""
        return self.held.by

    def on_state(self, callback: Callable[[str], None]) -> None:
        """Call with ``refused``, now and at each change."""
        self.held.on_state(callback)

    def _announcing(self, peer: Peer) -> dict[str, Any]:
        """Begin on a new connection; return what the announcement says besides its name and type.

        Raises ``UnknownType`` if the peer needs the definition.
        """
        graph, gateway = self._calls.graph, peer.dialect is ROPEWAY
        if not gateway:
            for part in self.parts:
                graph.registry.codec(f"{self.type}_{part}")
        self._peer = peer
        self.held.tell("")
        note = (graph.type_note(self.type) or None) if gateway else None
        return {"id": self.id, "compression": announced(self.delivery, peer), "ropeway": note}
