"""Displays the demo: a live table, lines if there is no terminal, and the summary."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from ropeway.cli.demo.flow import Tally
from ropeway.cli.fitting_table import FittingTable

__all__ = ["brief", "live_table", "summary_table"]

WAYS: Final = {"robot": "→ cloud", "cloud": "→ robot"}


_DISPENSABLE: Final = ("encoding", "p99 ms", "drops", "Mb/s", "way", "arrived")
_TEXT: Final = ("topic", "way", "encoding")


def live_table(flows: Iterable[Tally], figures: Mapping[str, Mapping[str, Any]], seconds: float) -> FittingTable:
    """Make the table of each route's last second; ``figures`` is what the gateways report, by topic."""
    title = f"Two DDS networks, two gateways, {seconds:.0f} s"
    table = FittingTable(
        title, "topic", "way", "Hz", "delay ms", "Mb/s", "drops", "encoding", dispensable=_DISPENSABLE, text=_TEXT
    )
    for flow in flows:
        now, told = flow.recent(), figures.get(flow.topic, {})
        table.add_row(
            flow.topic,
            WAYS[flow.side],
            f"{now.rate_hz:.0f}",
            _number(now.delay_ms),
            _number(now.bandwidth_bps / 1e6),
            str(sum(told.get("drops", {}).values())),
            str(told.get("encoding", "")),
        )
    return table


def summary_table(flows: Iterable[Tally], figures: Mapping[str, Mapping[str, Any]]) -> FittingTable:
    """Make the table of the whole run; the delays are the median and the 99th percentile."""
    table = FittingTable(
        "Summary",
        *("topic", "way", "arrived", "Hz", "p50 ms", "p99 ms", "Mb/s", "drops"),
        dispensable=_DISPENSABLE,
        text=_TEXT,
    )
    for flow in flows:
        total = flow.summary()
        table.add_row(
            flow.topic,
            WAYS[flow.side],
            f"{flow.arrived}/{flow.sent}",
            _number(total["rate_hz"]),
            _number(total["delay_ms_p50"]),
            _number(total["delay_ms_p99"]),
            _number(total["bandwidth_bps"] / 1e6),
            str(sum(figures.get(flow.topic, {}).get("drops", {}).values())),
        )
    return table


def brief(flows: Iterable[Tally], seconds: float) -> str:
    """Return one line for logs."""
    parts = [
        f"{flow.topic} {now.rate_hz:.0f} Hz {_number(now.delay_ms)} ms" for flow in flows for now in [flow.recent()]
    ]
    return f"{seconds:3.0f} s: {', '.join(parts)}"


def _number(value: float | None) -> str:
    """Write a number with three digits or so."""
    if value is None:
        return "-"
    return f"{value:.1f}" if value >= 1 else f"{value:.2f}"
