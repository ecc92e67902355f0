"""How the demo shows itself: a live table, lines where there is no terminal, and the summary."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rich.table import Table

from ropeway.cli.demo.flow import Flow

__all__ = ["brief", "live_table", "summary_table"]

ARROWS = {"robot": "robot → cloud", "cloud": "robot ← cloud"}


def live_table(flows: Iterable[Flow], routes: Mapping[str, Mapping[str, Any]], seconds: float) -> Table:
    """The last second of each route; ``routes`` is what the robot's gateway tells, by topic."""
    table = Table(title=f"Two networks joined, {seconds:.0f} s", title_justify="left")
    for column in ("topic", "way"):
        table.add_column(column)
    for column in ("rate", "delay", "bandwidth", "messages", "drops"):
        table.add_column(column, justify="right")
    table.add_column("encoding")
    table.add_column("state")
    for flow in flows:
        now, route = flow.recent(), routes.get(flow.topic, {})
        table.add_row(
            flow.topic,
            ARROWS[flow.side],
            f"{now.rate_hz:.0f} Hz",
            _ms(now.delay_ms),
            _bits(now.bandwidth_bps),
            str(flow.arrived),
            str(drops(route)),
            str(route.get("encoding", "")),
            str(route.get("state", "starting")),
        )
    return table


def summary_table(flows: Iterable[Flow], routes: Mapping[str, Mapping[str, Any]]) -> Table:
    """The whole run."""
    table = Table(title="Summary", title_justify="left")
    for column in ("topic", "way"):
        table.add_column(column)
    for column in ("sent", "arrived", "rate", "delay p50", "delay p99", "bandwidth", "drops"):
        table.add_column(column, justify="right")
    for flow in flows:
        total = flow.summary()
        table.add_row(
            flow.topic,
            ARROWS[flow.side],
            str(flow.sent),
            str(flow.arrived),
            f"{total['rate_hz']:.1f} Hz",
            _ms(total["delay_ms_p50"]),
            _ms(total["delay_ms_p99"]),
            _bits(total["bandwidth_bps"]),
            str(drops(routes.get(flow.topic, {}))),
        )
    return table


def brief(flows: Iterable[Flow], seconds: float) -> str:
    """One line for logs."""
    parts = [f"{flow.topic} {now.rate_hz:.0f} Hz {_ms(now.delay_ms)}" for flow in flows for now in [flow.recent()]]
    return f"{seconds:3.0f} s: {', '.join(parts)}"


def drops(route: Mapping[str, Any]) -> int:
    """How many messages of a route were dropped, for whatever reason."""
    return sum(route.get("drops", {}).values())


def _ms(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f} ms"


def _bits(bps: float) -> str:
    return f"{bps / 1e6:.1f} Mbit/s" if bps >= 1e6 else f"{bps / 1e3:.1f} kbit/s"
