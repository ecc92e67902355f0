"""Writes the metrics of routes as text: of a thousand routes once a second, at less than a hundredth of a core.

``prometheus_client`` takes a tenth of a second for as many, since it escapes every label of every line anew. Here a
route's labels are written once, and so are lines that have not changed since the last time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple

from ropeway.delivery.histogram import BOUNDS_S, HistogramJson

__all__ = ["ROUTE_STATES", "RouteMetrics"]

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
_LABELS: Final = ("operation", "name", "remote_name", "address")
_CLASSES: Final = (*(repr(bound_s) for bound_s in BOUNDS_S), "+Inf")
_STATE: Final = "ropeway_route_state"
_DELAYS: Final = "ropeway_route_message_delay_seconds"
_DURATIONS: Final = "ropeway_route_request_duration_seconds"


class _Family(NamedTuple):
    """A metric: its name without the ending of counters, what it is, its unit, and what it says."""

    name: str
    kind: str
    unit: str
    help: str


_FAMILIES: Final = (
    _Family(_STATE, "stateset", "", "The state of a route."),
    _Family("ropeway_route_messages", "counter", "", "Messages that crossed."),
    _Family("ropeway_route_payload_bytes", "counter", "bytes", "Their bytes, as the networks have them."),
    _Family("ropeway_route_drops", "counter", "", "Messages that did not cross, by reason."),
    _Family(
        "ropeway_route_delay_seconds", "gauge", "seconds", "Mean time from the first gateway to this one, last second."
    ),
    _Family(_DELAYS, "histogram", "seconds", "Time of messages from the first gateway to this one."),
    _Family("ropeway_route_publishers", "gauge", "", "Publishers on the side that it comes from."),
    _Family("ropeway_route_readers", "gauge", "", "Readers on the other side, where it is told."),
    _Family("ropeway_route_requests", "counter", "", "Calls and goals, by how they ended."),
    _Family("ropeway_route_requests_under_way", "gauge", "", "Calls and goals not yet answered."),
    _Family("ropeway_route_request_seconds", "gauge", "seconds", "How long calls take, smoothed."),
    _Family(_DURATIONS, "histogram", "seconds", "How long calls and goals took, however they ended."),
)
_IN_PLAIN_TEXT: Final = {"stateset": "gauge"}  # Prometheus' own format knows no sets of states


class _Route:
    """The labels of a route, and the lines that are written again only when something has changed."""

    __slots__ = ("_counts", "_histogram", "_open", "_state", "_states", "labels")

    def __init__(self, labels: tuple[str, ...]) -> None:
        operation, name, remote_name, address = labels
        told = [("operation", operation), ("name", name), ("address", address)]
        if remote_name != name:  # else one label less on every line
            told.append(("remote_name", remote_name))
        self._open = "{" + ",".join(f'{label}="{_escaped(value)}"' for label, value in told)
        self.labels = self._open + "}"
        self._state = self._states = ""
        self._counts: list[int] = []
        self._histogram = ""

    def states(self, state: str) -> str:
        """Return a line for each state that a route may have."""
        if state != self._state:
            self._state = state
            lines = [f'{_STATE}{self._open},{_STATE}="{known}"}} {int(known == state)}' for known in ROUTE_STATES]
            self._states = "\n".join(lines)
        return self._states

    def reason(self, reason: str, label: str) -> str:
        """Return the labels with one more."""
        return f'{self._open},{label}="{_escaped(reason)}"}}'

    def histogram(self, name: str, told: HistogramJson) -> str:
        """Return the lines of a histogram; a route has one at most."""
        counts = list(told["counts"])
        if counts != self._counts:
            self._counts = counts
            lines, total = [], 0
            for bound, count in zip(_CLASSES, counts, strict=True):
                total += count
                lines.append(f'{name}_bucket{self._open},le="{bound}"}} {total}')
            lines.append(f"{name}_count{self.labels} {total}")
            lines.append(f"{name}_sum{self.labels} {told['sum_s']}")
            self._histogram = "\n".join(lines)
        return self._histogram


class RouteMetrics:
    """Writes what the rows of routes in a status say, again and again."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, ...], _Route] = {}

    def text(self, rows: Iterable[Mapping[str, Any]], *, openmetrics: bool) -> str:
        """Return the metrics of all routes, in OpenMetrics or in Prometheus' own format."""
        lines: dict[str, list[str]] = {family.name: [] for family in _FAMILIES}
        before, self._known = self._known, {}
        for row in rows:
            key = tuple([str(row.get(label, row["name"])) for label in _LABELS])
            if key in self._known:  # of another type or graph: two series of the same labels would be none
                continue
            route = self._known[key] = before.get(key) or _Route(key)
            lines[_STATE].append(route.states(row["state"]))
            if "messages" in row:
                _topic(lines, route, row)
            elif "requests" in row:
                _calls(lines, route, row)
        return "\n".join([part for family in _FAMILIES for part in (*_head(family, openmetrics), *lines[family.name])])


def _topic(lines: Mapping[str, list[str]], route: _Route, row: Mapping[str, Any]) -> None:
    labels, delay_ms, readers, delays = route.labels, row["delay_ms"], row["readers"], row.get("delays")
    lines["ropeway_route_messages"].append(f"ropeway_route_messages_total{labels} {row['messages']}")
    lines["ropeway_route_payload_bytes"].append(f"ropeway_route_payload_bytes_total{labels} {row['bytes']}")
    lines["ropeway_route_publishers"].append(f"ropeway_route_publishers{labels} {row['publishers']}")
    if readers is not None:
        lines["ropeway_route_readers"].append(f"ropeway_route_readers{labels} {readers}")
    if delay_ms is not None:
        lines["ropeway_route_delay_seconds"].append(f"ropeway_route_delay_seconds{labels} {delay_ms / 1e3}")
    if delays is not None:
        lines[_DELAYS].append(route.histogram(_DELAYS, delays))
    for reason, count in row["drops"].items():
        lines["ropeway_route_drops"].append(f"ropeway_route_drops_total{route.reason(reason, 'reason')} {count}")


def _calls(lines: Mapping[str, list[str]], route: _Route, row: Mapping[str, Any]) -> None:
    labels, took_ms, durations = route.labels, row["took_ms"], row.get("durations")
    under_way = f"ropeway_route_requests_under_way{labels} {row['under_way']}"
    lines["ropeway_route_requests_under_way"].append(under_way)
    if took_ms is not None:
        lines["ropeway_route_request_seconds"].append(f"ropeway_route_request_seconds{labels} {took_ms / 1e3}")
    if durations is not None:
        lines[_DURATIONS].append(route.histogram(_DURATIONS, durations))
    for end, count in row["ended"].items():
        lines["ropeway_route_requests"].append(f"ropeway_route_requests_total{route.reason(end, 'end')} {count}")


def _head(family: _Family, openmetrics: bool) -> list[str]:
    if not openmetrics:
        name = f"{family.name}_total" if family.kind == "counter" else family.name
        return [f"# HELP {name} {family.help}", f"# TYPE {name} {_IN_PLAIN_TEXT.get(family.kind, family.kind)}"]
    unit = [f"# UNIT {family.name} {family.unit}"] if family.unit else []
    return [f"# HELP {family.name} {family.help}", f"# TYPE {family.name} {family.kind}", *unit]


def _escaped(value: str) -> str:
    return value.replace("\\", r"\\").replace("\n", r"\n").replace('"', r"\"")
