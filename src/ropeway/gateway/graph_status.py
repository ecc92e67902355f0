"""Says how a local network is, as the gateway on it sees it."""

from __future__ import annotations

from typing import Any

from ropeway.graph.layout_border import Distributed
from ropeway.hub.hub import Hub

__all__ = ["graph_status"]


def graph_status(url: str, hub: Hub) -> dict[str, Any]:
    """Return the state of the network at ``url`` as JSON."""
    graph = hub.graph
    topics, nodes = graph.counts()
    return {
        "graph": url,
        "topics": topics,
        "nodes": nodes,
        "duplicates": sum(hub.duplicates.values()),
        **({"distro": graph.distro} if isinstance(graph, Distributed) and graph.distro else {}),
        "drops": {f"{topic}: {why.value}": n for (topic, why), n in graph.drops.items() if n},
        "client_delays": hub.client_delays.to_json(),
    }
