"""The ``rosbridge`` graph: any rosbridge server or gateway on the far end of a WebSocket, seen as a graph."""

from __future__ import annotations

from ropeway.networks.rosbridge.client.graph import LinkState, RosbridgeGraph

__all__ = ["LinkState", "RosbridgeGraph"]
