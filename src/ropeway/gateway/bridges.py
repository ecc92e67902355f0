"""Makes the bridge of a route: which graph is the source, and which the target."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from ropeway.bridge.action import ActionBridge
from ropeway.bridge.service import ServiceBridge
from ropeway.bridge.topic import TopicBridge
from ropeway.delivery.passage import Keep
from ropeway.delivery.pipeline import Step, Witness
from ropeway.gateway.config.config import Route
from ropeway.graph.base import Graph

__all__ = ["INWARD", "fetch", "make_bridge", "make_topic_bridge"]

INWARD: Final = ("subscribe", "reserve-service", "reserve-action")
"""Operations whose source is the remote: what is there matters."""


def fetch(routes: Iterable[Route]) -> bool:
    """Return whether any of these routes has its source at the remote."""
    return any(route.operation in INWARD for route in routes)


def make_bridge(
    route: Route,
    local: Graph,
    remote: Graph,
    keep: Keep | None = None,
    frames: Step | None = None,
    witness: Witness | None = None,
) -> TopicBridge | ServiceBridge | ActionBridge:
    """Make a bridge between two graphs, not started yet."""
    if route.kind == "topic":
        return make_topic_bridge(route, local, remote, keep, frames, witness)
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
        witness=witness,
    )


def make_topic_bridge(
    route: Route,
    local: Graph,
    remote: Graph,
    keep: Keep | None = None,
    frames: Step | None = None,
    witness: Witness | None = None,
) -> TopicBridge:
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
        limit=route.operation not in INWARD,
        keep=keep,
        frames=frames,
        witness=witness,
    )


def _ends(route: Route, local: Graph, remote: Graph) -> tuple[Graph, Graph, str, str]:
    if route.operation in INWARD:
        return remote, local, route.remote_name, route.name
    return local, remote, route.name, route.remote_name
