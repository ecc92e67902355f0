"""Writes the metrics of routes as text: of a thousand routes once a second, at less than a hundredth of a core.

``prometheus_client`` takes a tenth of a second for as many, since it escapes every label of every line anew. Here a
route's labels are written once, and so are lines, and all lines of a metric, that have not changed since the last time.
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
    """The lines of a route, by the places of their families, as they were when ``row`` was what the status said of it.

    Labels are written once, and the lines of states and of the histogram, of which a route has one at most, when they
    change.
    """

    __slots__ = ("_counts", "_histogram", "_open", "_state", "_states", "key", "labels", "lines", "row")

    def __init__(self, key: tuple[str, ...]) -> None:
        self.key = key
        operation, name, remote_name, address = key
        told = [("operation", operation), ("name", name), ("address", address)]
        if remote_name != name:  # else one label less on every line
            told.append(("remote_name", remote_name))
        self._open = "{" + ",".join(f'{label}="{_escaped(value)}"' for label, value in told)
        self.labels = self._open + "}"
        self.row: Mapping[str, Any] = {}
        self.lines: list[str] = []
        self._state = self._states = ""
        self._counts: list[int] = []
        self._histogram = ""

    def write(self, row: Mapping[str, Any]) -> set[int]:
        """Write the lines of a row, and return the places of the families whose lines are others now."""
        self.row = row
        lines = {_STATE: self._told_states(row["state"])}
        if "messages" in row:
            lines |= self._topic(row)
        elif "requests" in row:
            lines |= self._calls(row)
        before, self.lines = self.lines, [lines.get(family.name, "") for family in _FAMILIES]
        if not before:
            return set(range(len(_FAMILIES)))
        return {place for place, (old, new) in enumerate(zip(before, self.lines, strict=True)) if old != new}

    def _told_states(self, state: str) -> str:
        if state != self._state:
            self._state = state
            lines = [f'{_STATE}{self._open},{_STATE}="{known}"}} {int(known == state)}' for known in ROUTE_STATES]
            self._states = "\n".join(lines)
        return self._states

    def _topic(self, row: Mapping[str, Any]) -> dict[str, str]:
        delay_ms = row["delay_ms"]
        gauges = {
            "ropeway_route_publishers": row["publishers"],
            "ropeway_route_readers": row["readers"],
            "ropeway_route_delay_seconds": None if delay_ms is None else delay_ms / 1e3,
        }
        return {
            **self._values(gauges),
            **self._values(
                {"ropeway_route_messages": row["messages"], "ropeway_route_payload_bytes": row["bytes"]}, "_total"
            ),
            "ropeway_route_drops": self._by("ropeway_route_drops_total", "reason", row["drops"]),
            _DELAYS: self._told_histogram(_DELAYS, row.get("delays")),
        }

    def _calls(self, row: Mapping[str, Any]) -> dict[str, str]:
        took_ms = row["took_ms"]
        gauges = {
            "ropeway_route_requests_under_way": row["under_way"],
            "ropeway_route_request_seconds": None if took_ms is None else took_ms / 1e3,
        }
        return {
            **self._values(gauges),
            "ropeway_route_requests": self._by("ropeway_route_requests_total", "end", row["ended"]),
            _DURATIONS: self._told_histogram(_DURATIONS, row.get("durations")),
        }

    def _values(self, values: Mapping[str, float | None], ending: str = "") -> dict[str, str]:
        return {name: f"{name}{ending}{self.labels} {value}" for name, value in values.items() if value is not None}

    def _by(self, name: str, label: str, counts: Mapping[str, int]) -> str:
        lines = [f'{name}{self._open},{label}="{_escaped(value)}"}} {count}' for value, count in counts.items()]
        return "\n".join(lines)

    def _told_histogram(self, name: str, told: HistogramJson | None) -> str:
        if told is None:
            return ""
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
        self._known: dict[str, _Route] = {}
        self._shown: list[_Route] = []
        self._blocks = [b""] * len(_FAMILIES)

    def text(self, rows: Iterable[Mapping[str, Any]], *, openmetrics: bool) -> bytes:
        """Return the metrics of all routes, in OpenMetrics or in Prometheus' own format."""
        shown: dict[tuple[str, ...], _Route] = {}
        changed: set[int] = set()
        before, self._known = self._known, {}
        for row in rows:
            key = row["key"]
            route = before.get(key)
            if route is None:
                route = _Route(tuple([str(row[label]) for label in _LABELS]))
            if row != route.row:
                changed |= route.write(row)
            self._known[key] = route
            shown.setdefault(route.key, route)  # of another type or graph: two series of the same labels are none
        routes = list(shown.values())
        if routes != self._shown:
            self._shown, changed = routes, set(range(len(_FAMILIES)))
        for place in changed:
            lines = [route.lines[place] for route in routes if route.lines[place]]
            self._blocks[place] = "".join([line + "\n" for line in lines]).encode()
        heads = [_head(family, openmetrics).encode() for family in _FAMILIES]
        return b"".join([part for pair in zip(heads, self._blocks, strict=True) for part in pair])


def _head(family: _Family, openmetrics: bool) -> str:
    if not openmetrics:
        name = f"{family.name}_total" if family.kind == "counter" else family.name
        return f"# HELP {name} {family.help}\n# TYPE {name} {_IN_PLAIN_TEXT.get(family.kind, family.kind)}\n"
    unit = f"# UNIT {family.name} {family.unit}\n" if family.unit else ""
    return f"# HELP {family.name} {family.help}\n# TYPE {family.name} {family.kind}\n{unit}"


def _escaped(value: str) -> str:
    return value.replace("\\", r"\\").replace("\n", r"\n").replace('"', r"\"")
