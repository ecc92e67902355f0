"""Makes the bridge of a route: which graph is the source, and which the target."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Final, Protocol

from ropeway.bridge.action import ActionBridge
from ropeway.bridge.options import BridgeOptions
from ropeway.bridge.service import ServiceBridge
from ropeway.bridge.topic import TopicBridge
from ropeway.delivery.frame_prefix import frame_step
from ropeway.gateway.config.config import Route
from ropeway.graph.base import Graph

if TYPE_CHECKING:
    from ropeway.delivery.passage import Keep
    from ropeway.delivery.pipeline import Tap, Witness
    from ropeway.types import TypeRegistry

__all__ = ["INWARD", "RouteHost", "bridge_options", "fetch", "make_bridge", "make_topic_bridge"]

INWARD: Final = ("subscribe", "reserve-service", "reserve-action")
"""Operations whose source is the remote: what is there matters."""


class RouteHost(Protocol):
    """Has what the options of routes need; ``Gateway`` is one."""

    registry: TypeRegistry

    def keeper(self, route: Route) -> Keep | None:
        """Return what keeps the last message of a route, if its configuration asks for it."""
        ...

    def witness(self, route: Route) -> Witness | None:
        """Return what writes down what crosses a route, if its configuration asks for it."""
        ...

    def tap(self, route: Route) -> Tap | None:
        """Return what records what crosses a route, if a recorder wants it."""
        ...


def bridge_options(route: Route, host: RouteHost) -> BridgeOptions:
    """Return how the bridge of a route treats what crosses it."""
    given = route.options
    return BridgeOptions(
        delivery=given.delivery,
        qos=given.qos,
        limit=route.operation not in INWARD,
        timeout_s=given.timeout_s,
        keep=host.keeper(route),
        frames=None if given.frames is None else frame_step(host.registry, route.type, given.frames),
        witness=host.witness(route),
        tap=host.tap(route),
    )


def fetch(routes: Iterable[Route]) -> bool:
    """Return whether any of these routes has its source at the remote."""
    return any(route.operation in INWARD for route in routes)


def make_bridge(
    route: Route, local: Graph, remote: Graph, options: BridgeOptions
) -> TopicBridge | ServiceBridge | ActionBridge:
    """Make a bridge between two graphs, not started yet."""
    if route.kind == "topic":
        return make_topic_bridge(route, local, remote, options)
    kind = ServiceBridge if route.kind == "service" else ActionBridge
    return kind(*_ends(route, local, remote), route.type, options)


def make_topic_bridge(route: Route, local: Graph, remote: Graph, options: BridgeOptions) -> TopicBridge:
    """Make a bridge for a topic, not started yet."""
    return TopicBridge(*_ends(route, local, remote), route.type, options)


def _ends(route: Route, local: Graph, remote: Graph) -> tuple[Graph, Graph, str, str]:
    if route.operation in INWARD:
        return remote, local, route.remote_name, route.name
    return local, remote, route.name, route.remote_name
