"""Tells how the bodies of calls and goals travel on a link, worked out once per type."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

from ropeway.errors import UnknownType
from ropeway.networks.rosbridge.protocol.codec import decode_value

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.client.host import LinkGraph
    from ropeway.types import MessageCodec

__all__ = ["Bodies", "Body"]


class Body:
    """Writes and reads messages of one type for a peer.

    ``codec`` is ``None`` where the definition is not known: gateways get raw bytes then.
    """

    __slots__ = ("_border", "_type", "codec", "state")

    def __init__(self, graph: LinkGraph, type: str, state: object) -> None:
        self.state = state
        self._type = type
        self._border = graph.border if graph.border.touches(type) else None
        self.codec: MessageCodec | None = None
        with contextlib.suppress(UnknownType):
            self.codec = graph.spelling.codec(type)

    def read(self, value: Any, encoding: str | None, limit_bytes: int) -> bytes:
        """Decode a received value to CDR in our layout. Raises ``TypesError``, ``WireError``."""
        payload = decode_value(value, encoding, self.codec, limit_bytes=limit_bytes)
        return payload if self._border is None else self._border.incoming(self._type, payload)

    def written(self, payload: bytes) -> bytes:
        """Return our CDR in the layout of the far graph. Raises ``ValueMismatch``."""
        return payload if self._border is None else self._border.outgoing(self._type, payload)


class Bodies:
    """The bodies of all types on the link of ``graph``.

    What was worked out holds until types are learned or forgotten, or the peer shows another dialect or ROS.
    """

    def __init__(self, graph: LinkGraph) -> None:
        self._graph = graph
        self._known: dict[str, Body] = {}

    def of(self, type: str) -> Body:
        """Return how messages of ``type`` travel now."""
        graph = self._graph
        ours, peer = graph.border.ours, graph.peer
        state = (graph.registry.changes, ours and ours.changes, graph.spelling.ros1, peer and peer.dialect)
        found = self._known.get(type)
        if found is None or found.state != state:
            found = self._known[type] = Body(graph, type, state)
        return found

    def clear(self) -> None:
        """Forget all: the link is gone."""
        self._known.clear()
