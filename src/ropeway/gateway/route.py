"""A route of a running gateway: the bridge that carries it out, and the one place that says how it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from operator import attrgetter
from typing import Any, Final

from ropeway.bridge.action import ActionBridge
from ropeway.bridge.service import ServiceBridge
from ropeway.bridge.topic import TopicBridge
from ropeway.delivery.histogram import HistogramJson
from ropeway.gateway.config.config import Route
from ropeway.graph.base import look_up
from ropeway.graph.link_parts import LinkStatistics, is_encoded, is_linked, is_refusable
from ropeway.listener.http import without_token

__all__ = ["Bridge", "CallFigures", "Doubt", "RouteStatus", "RunningRoute", "TopicFigures", "paused_status"]

Bridge = TopicBridge | ServiceBridge | ActionBridge

_CONNECTED: Final = "connected"
PAUSED: Final = "paused"
"""The state of a route that the configuration has with ``"active": false``."""


@dataclass(frozen=True, slots=True)
class TopicFigures:
    """The figures of a topic. ``drops`` counts messages that were not passed on, by reason.

    ``publishers`` are on the side that it comes from, ``readers`` on the other, ``None`` where nobody tells. ``delays``
    are those of messages that came from another gateway, ``None`` before the first.
    """

    publishers: int = 0
    readers: int | None = None
    messages: int = 0
    bytes: int = 0
    rate_hz: float = 0.0
    bandwidth_bps: int = 0
    delay_ms: float | None = None
    drops: Mapping[str, int] = field(default_factory=dict)
    delays: HistogramJson | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the figures as JSON."""
        return dict(zip(_TOPIC, _topic_figures(self), strict=True))


_TOPIC: Final = tuple(TopicFigures.__dataclass_fields__)
_topic_figures: Final = attrgetter(*_TOPIC)


@dataclass(frozen=True, slots=True)
class CallFigures:
    """The figures of a service or an action: ``ended`` counts calls by how they ended, ``durations`` are theirs."""

    requests: int = 0
    under_way: int = 0
    ended: Mapping[str, int] = field(default_factory=dict)
    took_ms: float | None = None
    durations: HistogramJson | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the figures as JSON."""
        return dict(zip(_CALLS, _call_figures(self), strict=True))


_CALLS: Final = tuple(CallFigures.__dataclass_fields__)
_call_figures: Final = attrgetter(*_CALLS)


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
        row = dict(zip(_PLAIN, _plain(self), strict=True))
        if self.figures is not None:
            row.update(self.figures.to_json())
        return row


_PLAIN: Final = tuple(key for key in RouteStatus.__dataclass_fields__ if key != "figures")
_plain: Final = attrgetter(*_PLAIN)


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
        address=_shown(route.remote.addresses),
        type=route.type,
        state=state,
        error=error,
        reason=reason,
        encoding=encoding,
        figures=figures,
    )


@lru_cache(maxsize=1024)
def _shown(addresses: tuple[str, ...]) -> str:
    return ",".join(map(without_token, addresses))


def _calls(bridge: ServiceBridge | ActionBridge) -> CallFigures:
    return CallFigures(
        requests=sum(bridge.counts.values()),
        under_way=bridge.under_way,
        ended=dict(bridge.counts),
        took_ms=None if bridge.took_s is None else round(1e3 * bridge.took_s, 3),
        durations=bridge.durations.to_json(),
    )


def _topic(route: Route, bridge: TopicBridge) -> tuple[str, str, TopicFigures]:
    meter = bridge.meter
    drops: dict[str, int] = {reason.value: n for reason, n in bridge.drops.items() if n}
    delay, encoding = meter.delay_s, route.delivery.encoding
    publisher: object = bridge.publisher
    subscription: object = bridge.subscription
    link = publisher.statistics() if is_linked(publisher) else LinkStatistics()
    if link.encoding is not None:
        encoding = link.encoding
    elif is_encoded(subscription):
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
        delays=meter.delays.to_json(),
    )
    refused = link.refused or (subscription.refused if is_refusable(subscription) else "")
    return bridge.error or refused, encoding, figures
