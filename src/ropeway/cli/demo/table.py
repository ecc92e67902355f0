"""How the demo shows itself: a live table, lines where there is no terminal, and the summary."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from rich.table import Table

from ropeway.cli.demo.flow import Flow

__all__ = ["brief", "live_table", "summary_table"]

WAYS: Final = {"robot": "→ cloud", "cloud": "→ robot"}


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, padding=(0, 1), header_style="bold")
    for name in columns:
        text = name in ("topic", "way", "encoding")
        table.add_column(
            name, justify="left" if text else "right", no_wrap=True, overflow="ellipsis" if text else "fold"
        )
    return table


def live_table(flows: Iterable[Flow], figures: Mapping[str, Mapping[str, Any]], seconds: float) -> Table:
    """The last second of each route; ``figures`` is what the gateways tell, by topic."""
    title = f"Two DDS networks, two gateways, {seconds:.0f} s"
    table = _table(title, "topic", "way", "Hz", "delay ms", "Mb/s", "drops", "encoding")
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


def summary_table(flows: Iterable[Flow], figures: Mapping[str, Mapping[str, Any]]) -> Table:
    """The whole run; the delays are the median and the 99th percentile."""
    table = _table("Summary", "topic", "way", "arrived", "Hz", "p50 ms", "p99 ms", "Mb/s", "drops")
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


def brief(flows: Iterable[Flow], seconds: float) -> str:
    """One line for logs."""
    parts = [
        f"{flow.topic} {now.rate_hz:.0f} Hz {_number(now.delay_ms)} ms" for flow in flows for now in [flow.recent()]
    ]
    return f"{seconds:3.0f} s: {', '.join(parts)}"


def _number(value: float | None) -> str:
    """Three digits or so."""
    if value is None:
        return "-"
    return f"{value:.1f}" if value >= 1 else f"{value:.2f}"
