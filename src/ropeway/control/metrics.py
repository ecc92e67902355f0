"""Makes metrics for Prometheus of the status of a gateway: everything with its unit and a help text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import accumulate
from typing import TYPE_CHECKING, Any, Final

from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
    StateSetMetricFamily,
)
from prometheus_client.exposition import choose_encoder

from ropeway import __version__
from ropeway.control.route_metrics import RouteMetrics
from ropeway.delivery.histogram import BOUNDS_S, HistogramJson, added
from ropeway.gateway.link_rows import each_link

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["LINK_STATES", "Metrics", "StatusCollector"]

LINK_STATES: Final = ("connected", "connecting", "waiting to retry", "failed", "closed")
_OPENMETRICS: Final = "application/openmetrics-text"
_END_OF_OPENMETRICS: Final = b"# EOF\n"
_LINK: Final = ("address",)
_GRAPH: Final = ("graph",)
_ENDS: Final = (*map(repr, BOUNDS_S), "+Inf")


class Metrics:
    """Writes the metrics of a gateway, again and again."""

    def __init__(self, status: Callable[[], Mapping[str, Any]]) -> None:
        self._status = status
        self._routes = RouteMetrics()

    def text(self, accept: str = "") -> tuple[bytes, str]:
        """Return the metrics as they are now, and their media type: the one of those in ``accept`` that we know."""
        status = self._status()
        encode, media_type = _encoder(accept)
        registry = CollectorRegistry(auto_describe=False)
        registry.register(StatusCollector(lambda: status))
        ProcessCollector(registry=registry)
        openmetrics = media_type.startswith(_OPENMETRICS)
        end = _END_OF_OPENMETRICS if openmetrics else b""
        routes = self._routes.text(status["routes"], openmetrics=openmetrics)
        return b"%b%b%b" % (encode(registry).removesuffix(end), routes, end), media_type


def _encoder(accept: str) -> tuple[Callable[[Any], bytes], str]:
    """Return the format that is asked for. Versions and escapings count for nothing: our names need neither."""
    return choose_encoder(_OPENMETRICS if _OPENMETRICS in accept else "")


class StatusCollector:
    """Collects metrics from what ``status`` returns, all but those of routes: for ``prometheus_client``."""

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
        yield from _links(status["remotes"])
        yield from _graphs(status["graphs"])
        yield from _clients(status)
        memory = status["memory"]
        yield _one(
            "ropeway_connections_held_bytes", "Bytes that connections have the gateway hold.", memory["held_bytes"]
        )
        yield _one("ropeway_connections_limit_bytes", "Bytes that they may have it hold.", memory["limit_bytes"])
        yield from _codecs(status["codecs"])
        yield _one("ropeway_failed_tasks", "Background work that has failed and is tried again.", len(status["failed"]))


def _one(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(name, text, value=value)


def _gauge(name: str, text: str, labels: Sequence[str]) -> GaugeMetricFamily:
    return GaugeMetricFamily(name, text, labels=labels)


def _counter(name: str, text: str, labels: Sequence[str]) -> CounterMetricFamily:
    return CounterMetricFamily(name, text, labels=labels)


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


def _graphs(graphs: Sequence[Mapping[str, Any]]) -> Iterator[Metric]:
    topics = _gauge("ropeway_graph_topics", "Topics on a local network.", _GRAPH)
    nodes = _gauge("ropeway_graph_nodes", "Nodes on a local network.", _GRAPH)
    duplicates = _counter("ropeway_graph_duplicates", "Messages that had come another way already.", _GRAPH)
    drops = _counter(
        "ropeway_graph_drops",
        "Messages that the network did not take or give, by topic and reason.",
        labels=(*_GRAPH, "reason"),
    )
    delays = HistogramMetricFamily(
        "ropeway_client_message_delay_seconds",
        "Time of messages that clients publish or read from the first gateway to this one.",
        labels=(*_GRAPH, "direction", "topic"),
    )
    for name in dict.fromkeys(str(graph["graph"]) for graph in graphs):
        mine = [graph for graph in graphs if graph["graph"] == name]  # of all workers that have joined it
        topics.add_metric([name], max(graph["topics"] for graph in mine))
        nodes.add_metric([name], max(graph["nodes"] for graph in mine))
        duplicates.add_metric([name], sum(graph["duplicates"] for graph in mine))
        for reason, count in sum((Counter(graph["drops"]) for graph in mine), Counter[str]()).items():
            drops.add_metric([name, reason], count)
        for direction in ("published", "read"):
            told = added(graph.get("client_delays", {}).get(direction, {}) for graph in mine)
            for topic, histogram in told.items():
                delays.add_metric([name, direction, topic], _buckets(histogram), histogram["sum_s"])
    yield from (topics, nodes, duplicates, drops, delays)


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


def _codecs(codecs: Mapping[str, Any]) -> Iterator[Metric]:
    for way, text in (("encode", "encoded"), ("decode", "decoded")):
        family = HistogramMetricFamily(
            f"ropeway_{way}_seconds", f"How long messages took to be {text}, by encoding.", labels=("encoding",)
        )
        for encoding, told in codecs[way].items():
            family.add_metric([encoding], _buckets(told), told["sum_s"])
        yield family


def _buckets(told: HistogramJson) -> list[tuple[str, float]]:
    return list(zip(_ENDS, accumulate(told["counts"]), strict=True))
