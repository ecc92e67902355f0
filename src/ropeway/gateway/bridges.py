"""Makes the bridge of a route: which graph is the source, and which the target."""

from __future__ import annotations

from ropeway.bridge.action import ActionBridge
from ropeway.bridge.service import ServiceBridge
from ropeway.bridge.topic import TopicBridge
from ropeway.delivery.passage import Keep
from ropeway.gateway.config.config import Route
from ropeway.graph.base import Graph

__all__ = ["make_bridge", "make_topic_bridge"]

_INWARD = ("subscribe", "reserve-service", "reserve-action")


def make_bridge(
    route: Route, local: Graph, remote: Graph, keep: Keep | None = None
) -> TopicBridge | ServiceBridge | ActionBridge:
    """Make a bridge between two graphs, not started yet."""
    if route.kind == "topic":
        return make_topic_bridge(route, local, remote, keep)
    source, target, source_name, target_name = _ends(route, local, remote)
    kind = ServiceBridge if route.kind == "service" else ActionBridge
    return kind(
        source,
        target,
        source_name,
        target_name,
        route.type,
        timeout_s=route.timeout_s,
        delivery=route.delivery,
    )


def make_topic_bridge(route: Route, local: Graph, remote: Graph, keep: Keep | None = None) -> TopicBridge:
    """Make a bridge for a topic, not started yet."""
    source, target, source_name, target_name = _ends(route, local, remote)
    return TopicBridge(
        source,
        target,
        source_name,
        target_name,
        route.type,
        qos=route.qos,
        delivery=route.delivery,
        limit=route.operation not in _INWARD,
        keep=keep,
    )


def _ends(route: Route, local: Graph, remote: Graph) -> tuple[Graph, Graph, str, str]:
    if route.operation in _INWARD:
        return remote, local, route.remote_name, route.name
    return local, remote, route.name, route.remote_name
