"""A route of a running gateway: the bridge that carries it out, and the one place that says how it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from operator import attrgetter
from typing import Any, Final, NamedTuple

from ropeway.bridge.action import ActionBridge
from ropeway.bridge.service import ServiceBridge
from ropeway.bridge.topic import TopicBridge
from ropeway.delivery.histogram import Histogram, HistogramJson
from ropeway.gateway.config.config import Route
from ropeway.graph.link_parts import NO_LOSSES, LinkStatistics, is_encoded, is_linked, is_refusable
from ropeway.listener.http import without_token

__all__ = ["Bridge", "CallFigures", "Doubt", "RouteStatus", "RunningRoute", "TopicFigures", "paused_status"]

Bridge = TopicBridge | ServiceBridge | ActionBridge

_CONNECTED: Final = "connected"
_NO_LINK: Final = LinkStatistics()
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


@dataclass(frozen=True)
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
        return self._row.copy()

    @cached_property
    def _row(self) -> dict[str, Any]:
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

    __slots__ = ("_seen", "_told", "bridge", "doubt", "route")

    def __init__(self, route: Route, bridge: Bridge) -> None:
        self.route, self.bridge = route, bridge
        self.doubt: Doubt | None = None
        self._seen: tuple[object, ...] = ()
        self._told: RouteStatus | None = None

    def status(self, link_state: str = _CONNECTED) -> RouteStatus:
        """Return how the route is, while the link that it goes over is in ``link_state``.

        The same object comes back until something has changed: of a thousand routes that are asked for once a second
        most are as they were.
        """
        bridge = self.bridge
        facts = _TopicFacts.of(bridge) if isinstance(bridge, TopicBridge) else _CallFacts.of(bridge)
        seen = (self.route, link_state, self.doubt, facts)
        told = self._told
        if told is None or seen != self._seen:
            self._seen = seen
            told = self._told = self._tell(link_state, facts)
        return told

    def _tell(self, link_state: str, facts: _TopicFacts | _CallFacts) -> RouteStatus:
        route, doubt, error = self.route, self.doubt, facts.error
        encoding = facts.encoding or route.options.delivery.encoding
        figures = facts.figures()
        if link_state != _CONNECTED:
            return _status(route, link_state, error, encoding, figures)
        if doubt is None:
            return _status(route, facts.state, error, encoding, figures)
        error = error or (doubt.reason if doubt.certain else "")
        return _status(route, facts.state, error, encoding, figures, doubt.reason)


def paused_status(route: Route) -> RouteStatus:
    """Return how a route is that the configuration has, and that does not run."""
    figures = TopicFigures() if route.kind == "topic" else CallFigures()
    return _status(route, PAUSED, "", route.options.delivery.encoding, figures)


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


class _TopicFacts(NamedTuple):
    """Holds everything that the status of a topic is made of, as cheap to have as to compare."""

    error: str
    state: str
    encoding: str
    link: LinkStatistics
    publishers: int
    readers: int | None
    messages: int
    bytes: int
    rate_hz: float
    rate_bps: float
    delay_s: float | None
    dropped: Mapping[str, int]
    delays: Histogram
    delays_ns: int

    @classmethod
    def of(cls, bridge: TopicBridge) -> _TopicFacts:
        """Return how a topic is now."""
        meter, publisher, subscription = bridge.meter, bridge.publisher, bridge.subscription
        link = publisher.statistics() if is_linked(publisher) else _NO_LINK
        encoding, error = link.encoding, bridge.error
        state = "failed" if error else bridge.progress
        refused = link.refused
        if subscription is not None:  # most of a thousand routes are idle
            if encoding is None and is_encoded(subscription):
                encoding = subscription.encoding
            if not refused and is_refusable(subscription):
                refused = subscription.refused
        publishers, _ = bridge.source.count_publishers(bridge.source_topic)
        return cls(
            error or refused,
            state,
            encoding or "",
            link,
            publishers,
            None if publisher is None else publisher.subscribers,
            meter.messages,
            meter.bytes,
            meter.rate_hz,
            meter.rate_bps,
            link.delay_s if meter.delay_s is None else meter.delay_s,
            {reason.value: n for reason, n in bridge.drops.items() if n} if bridge.drops else NO_LOSSES,
            meter.delays,
            meter.delays.sum_ns,
        )

    def figures(self) -> TopicFigures:
        """Return the figures for people and programs."""
        return TopicFigures(
            publishers=self.publishers,
            readers=self.readers,
            messages=self.messages,
            bytes=self.bytes,
            rate_hz=round(self.rate_hz, 2),
            bandwidth_bps=round(self.rate_bps),
            delay_ms=None if self.delay_s is None else round(1e3 * self.delay_s, 3),
            drops={**self.dropped, **self.link.lost},
            delays=self.delays.to_json(),
        )


class _CallFacts(NamedTuple):
    """Holds everything that the status of a service or an action is made of."""

    error: str
    state: str
    encoding: str
    under_way: int
    ended: Mapping[str, int]
    took_s: float | None
    durations: Histogram

    @classmethod
    def of(cls, bridge: ServiceBridge | ActionBridge) -> _CallFacts:
        """Return how a service or an action is now."""
        return cls(
            bridge.error or (f"offered by {bridge.taken_by}" if bridge.taken_by else ""),
            bridge.state,
            bridge.encoding,
            bridge.under_way,
            dict(bridge.counts),
            bridge.took_s,
            bridge.durations,
        )

    def figures(self) -> CallFigures:
        """Return the figures for people and programs."""
        return CallFigures(
            requests=sum(self.ended.values()),
            under_way=self.under_way,
            ended=self.ended,
            took_ms=None if self.took_s is None else round(1e3 * self.took_s, 3),
            durations=self.durations.to_json(),
        )
