"""A route of a running gateway: the bridge that carries it out, and the one place that says how it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from ropeway.bridge.action import ActionBridge
from ropeway.bridge.service import ServiceBridge
from ropeway.bridge.topic import TopicBridge
from ropeway.gateway.config.config import Route
from ropeway.graph.base import look_up
from ropeway.graph.link_parts import Encoded, LinkedPublisher, LinkStatistics, Refusable
from ropeway.listener.http import without_token

__all__ = ["Bridge", "CallFigures", "Doubt", "RouteStatus", "RunningRoute", "TopicFigures", "paused_status"]

Bridge = TopicBridge | ServiceBridge | ActionBridge

_CONNECTED: Final = "connected"
PAUSED: Final = "paused"
"""The state of a route that the configuration has with ``"active": false``."""


@dataclass(frozen=True, slots=True)
class TopicFigures:
    """The figures of a topic. ``drops`` counts messages that were not passed on, by reason.

    ``publishers`` are on the side that it comes from, ``readers`` on the other, ``None`` where nobody tells.
    """

    publishers: int = 0
    readers: int | None = None
    messages: int = 0
    bytes: int = 0
    rate_hz: float = 0.0
    bandwidth_bps: int = 0
    delay_ms: float | None = None
    drops: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class CallFigures:
    """The figures of a service or an action: ``ended`` counts calls by how they ended."""

    requests: int = 0
    under_way: int = 0
    ended: Mapping[str, int] = field(default_factory=dict)
    took_ms: float | None = None


@dataclass(frozen=True, slots=True)
class RouteStatus:
    """The state of a route. ``key`` stays the same while operation, address, names and type do.

    ``state`` is ``active``, ``idle`` (nobody reads), ``waiting``, ``failed``, ``paused``, or that of the link where it
    is not connected; ``error`` says why. ``reason`` says why nothing crosses though nothing has failed.
    """

    key: str
    kind: str
    path: str
    operation: str
    name: str
    remote_name: str
    address: str
    type: str
    state: str
    error: str = ""
    reason: str = ""
    encoding: str = ""
    figures: TopicFigures | CallFigures | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the row of the table of routes: all of it on one level."""
        row = {key: getattr(self, key) for key in _PLAIN}
        if self.figures is not None:
            row.update(asdict(self.figures))
        return row


_PLAIN: Final = tuple(key for key in RouteStatus.__dataclass_fields__ if key != "figures")


@dataclass(frozen=True, slots=True)
class Doubt:
    """A reason why nothing crosses; one that is ``certain`` stays until somebody changes something."""

    reason: str
    certain: bool


class RunningRoute:
    """A route and its bridge. ``doubt`` is kept by whoever watches the route."""

    __slots__ = ("bridge", "doubt", "route")

    def __init__(self, route: Route, bridge: Bridge) -> None:
        self.route, self.bridge = route, bridge
        self.doubt: Doubt | None = None

    def status(self, link_state: str = _CONNECTED) -> RouteStatus:
        """Return how the route is, while the link that it goes over is in ``link_state``."""
        bridge = self.bridge
        figures: TopicFigures | CallFigures
        if isinstance(bridge, TopicBridge):
            error, encoding, figures = _topic(self.route, bridge)
        else:
            error = bridge.error or (f"offered by {bridge.taken_by}" if bridge.taken_by else "")
            encoding, figures = bridge.encoding, _calls(bridge)
        if link_state != _CONNECTED:
            return _status(self.route, link_state, error, encoding, figures)
        doubt = self.doubt
        if doubt is None:
            return _status(self.route, bridge.state, error, encoding, figures)
        error = error or (doubt.reason if doubt.certain else "")
        return _status(self.route, bridge.state, error, encoding, figures, doubt.reason)


def paused_status(route: Route) -> RouteStatus:
    """Return how a route is that the configuration has, and that does not run."""
    figures = TopicFigures() if route.kind == "topic" else CallFigures()
    return _status(route, PAUSED, "", route.delivery.encoding, figures)


def _status(
    route: Route,
    state: str,
    error: str,
    encoding: str,
    figures: TopicFigures | CallFigures | None,
    reason: str = "",
) -> RouteStatus:
    return RouteStatus(
        key=route.key,
        kind=route.kind,
        path=route.path,
        operation=route.operation,
        name=route.name,
        remote_name=route.remote_name,
        address=",".join(map(without_token, route.remote.addresses)),
        type=route.type,
        state=state,
        error=error,
        reason=reason,
        encoding=encoding,
        figures=figures,
    )


def _calls(bridge: ServiceBridge | ActionBridge) -> CallFigures:
    return CallFigures(
        requests=sum(bridge.counts.values()),
        under_way=bridge.under_way,
        ended=dict(bridge.counts),
        took_ms=None if bridge.took_s is None else round(1e3 * bridge.took_s, 3),
    )


def _topic(route: Route, bridge: TopicBridge) -> tuple[str, str, TopicFigures]:
    meter = bridge.meter
    drops: dict[str, int] = {reason.value: n for reason, n in bridge.drops.items() if n}
    delay, encoding = meter.delay_s, route.delivery.encoding
    publisher: object = bridge.publisher
    subscription: object = bridge.subscription
    link = publisher.statistics() if isinstance(publisher, LinkedPublisher) else LinkStatistics()
    if link.encoding is not None:
        encoding = link.encoding
    elif isinstance(subscription, Encoded):
        encoding = subscription.encoding
    drops.update(link.lost)
    if delay is None:
        delay = link.delay_s
    known = look_up(bridge.source, "topic", bridge.source_topic)
    figures = TopicFigures(
        publishers=0 if known is None else sum(not end.local for end in known.publishers),
        readers=None if bridge.publisher is None else bridge.publisher.subscribers,
        messages=meter.messages,
        bytes=meter.bytes,
        rate_hz=round(meter.rate_hz, 2),
        bandwidth_bps=round(meter.rate_bps),
        delay_ms=None if delay is None else round(1e3 * delay, 3),
        drops=drops,
    )
    refused = link.refused or (subscription.refused if isinstance(subscription, Refusable) else "")
    return bridge.error or refused, encoding, figures
