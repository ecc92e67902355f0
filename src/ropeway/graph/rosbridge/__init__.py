"""The ``rosbridge`` graph: any rosbridge server or gateway on the far end of a WebSocket, seen as a graph."""

from __future__ import annotations

from ropeway.graph.rosbridge.graph import LinkState, RosbridgeGraph

__all__ = ["LinkState", "RosbridgeGraph"]
