"""Makes metrics for Prometheus of the status of a gateway: every counter and gauge with its unit and a help text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    InfoMetricFamily,
    Metric,
    StateSetMetricFamily,
)

from ropeway import __version__
from ropeway.control.links import each_link

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["LINK_STATES", "ROUTE_STATES", "StatusCollector"]

ROUTE_STATES: Final = (
    "active",
    "idle",
    "waiting",
    "taken",
    "failed",
    "paused",
    "connecting",
    "waiting to retry",
    "closed",
)
LINK_STATES: Final = ("connected", "connecting", "waiting to retry", "failed", "closed")
_ROUTE: Final = ("operation", "name", "address")
_LINK: Final = ("address",)
_GRAPH: Final = ("graph",)


class StatusCollector:
    """Collects metrics from what ``status`` returns; a collector for a registry of ``prometheus_client``."""

    def __init__(self, status: Callable[[], Mapping[str, Any]]) -> None:
        self._status = status

    def collect(self) -> Iterator[Metric]:
        """Yield every metric as it is now."""
        status = self._status()
        yield InfoMetricFamily(
            "ropeway_gateway",
            "The gateway: its name and version.",
            value={"name": str(status["name"]), "version": __version__},
        )
        yield from _routes(status["routes"])
        yield from _links(status["remotes"])
        yield from _graphs(status["graphs"])
        yield from _clients(status)
        memory = status["memory"]
        yield _one(
            "ropeway_connections_held_bytes", "Bytes that connections have the gateway hold.", memory["held_bytes"]
        )
        yield _one("ropeway_connections_limit_bytes", "Bytes that they may have it hold.", memory["limit_bytes"])
        yield _one("ropeway_failed_tasks", "Background work that has failed and is tried again.", len(status["failed"]))


def _one(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(name, text, value=value)


def _gauge(name: str, text: str, labels: Sequence[str]) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, text, labels=labels)


def _counter(name: str, text: str, labels: Sequence[str]) -> CounterMetricFamily:
    return CounterMetricFamily(name, text, labels=labels)


def _routes(rows: Iterable[Mapping[str, Any]]) -> Iterator[Metric]:
    state = StateSetMetricFamily("ropeway_route_state", "The state of a route.", labels=_ROUTE)
    messages = _counter("ropeway_route_messages", "Messages that crossed.", _ROUTE)
    carried = _counter("ropeway_route_payload_bytes", "Their bytes, as the networks have them.", _ROUTE)
    drops = _counter("ropeway_route_drops", "Messages that did not cross, by reason.", (*_ROUTE, "reason"))
    delay = _gauge("ropeway_route_delay_seconds", "Mean time from the first gateway to this one, last second.", _ROUTE)
    publishers = _gauge("ropeway_route_publishers", "Publishers on the side that it comes from.", _ROUTE)
    readers = _gauge("ropeway_route_readers", "Readers on the other side, where it is told.", _ROUTE)
    requests = _counter("ropeway_route_requests", "Calls and goals, by how they ended.", (*_ROUTE, "end"))
    under_way = _gauge("ropeway_route_requests_under_way", "Calls and goals not yet answered.", _ROUTE)
    took = _gauge("ropeway_route_request_seconds", "How long calls take, smoothed.", _ROUTE)
    for row in rows:
        labels = [str(row[key]) for key in _ROUTE]
        state.add_metric(labels, {name: row["state"] == name for name in ROUTE_STATES})
        if "messages" in row:
            messages.add_metric(labels, row["messages"])
            carried.add_metric(labels, row["bytes"])
            publishers.add_metric(labels, row["publishers"])
            _add(delay, labels, row["delay_ms"], 1e-3)
            _add(readers, labels, row["readers"])
            for reason, count in row["drops"].items():
                drops.add_metric([*labels, reason], count)
        elif "requests" in row:
            under_way.add_metric(labels, row["under_way"])
            _add(took, labels, row["took_ms"], 1e-3)
            for end, count in row["ended"].items():
                requests.add_metric([*labels, end], count)
    yield from (state, messages, carried, drops, delay, publishers, readers, requests, under_way, took)


def _add(metric: GaugeMetricFamily, labels: list[str], value: float | None, factor: float = 1.0) -> None:
    if value is not None:
        metric.add_metric(labels, value * factor)


def _links(remotes: Iterable[Mapping[str, Any]]) -> Iterator[Metric]:
    state = StateSetMetricFamily("ropeway_link_state", "The state of the link to a remote.", labels=_LINK)
    connections = _counter("ropeway_link_connections", "Connections made, the first included.", _LINK)
    round_trip = _gauge("ropeway_link_round_trip_seconds", "Round trip to the remote.", _LINK)
    pace = _gauge("ropeway_link_pace_bits_per_second", "What the link carries, as estimated.", _LINK)
    received = _counter("ropeway_link_received_bytes", "Bytes that came over the link.", _LINK)
    sent = _counter("ropeway_link_sent_bytes", "Bytes that went over the link.", _LINK)
    for name, remote in each_link(remotes):
        labels = [name]
        state.add_metric(labels, {known: remote.get("state") == known for known in LINK_STATES})
        if "connections" in remote:
            connections.add_metric(labels, remote["connections"])
            received.add_metric(labels, remote["bytes_in"])
            sent.add_metric(labels, remote["bytes_out"])
            _add(round_trip, labels, remote["rtt_ms"], 1e-3)
            _add(pace, labels, remote["pace_bps"])
    yield from (state, connections, round_trip, pace, received, sent)


def _graphs(graphs: Iterable[Mapping[str, Any]]) -> Iterator[Metric]:
    topics = _gauge("ropeway_graph_topics", "Topics on a local network.", _GRAPH)
    nodes = _gauge("ropeway_graph_nodes", "Nodes on a local network.", _GRAPH)
    duplicates = _counter("ropeway_graph_duplicates", "Messages that had come another way already.", _GRAPH)
    drops = _counter(
        "ropeway_graph_drops",
        "Messages that the network did not take or give, by topic and reason.",
        labels=(*_GRAPH, "reason"),
    )
    for graph in graphs:
        labels = [str(graph["graph"])]
        topics.add_metric(labels, graph["topics"])
        nodes.add_metric(labels, graph["nodes"])
        duplicates.add_metric(labels, graph["duplicates"])
        for reason, count in graph["drops"].items():
            drops.add_metric([*labels, reason], count)
    yield from (topics, nodes, duplicates, drops)


def _clients(status: Mapping[str, Any]) -> Iterator[Metric]:
    sessions = _gauge("ropeway_sessions", "Clients and gateways that are connected.", ("dialect", "role"))
    counts = Counter((str(session["dialect"]), str(session["role"])) for session in status["sessions"])
    for labels, count in counts.items():
        sessions.add_metric(labels, count)
    refused = _counter("ropeway_refused_connections", "Connections that were refused, by reason.", ("reason",))
    for reason, count in status["access"].get("refused", {}).items():
        refused.add_metric([reason], count)
    denied = _counter("ropeway_denied_operations", "Operations that a role does not allow.", ("operation",))
    for operation, count in status["access"].get("denied", {}).items():
        denied.add_metric([operation], count)
    yield from (sessions, refused, denied)
