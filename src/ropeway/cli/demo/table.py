"""Displays the demo: a live table, lines if there is no terminal, and the summary."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final

from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table

from ropeway.cli.demo.flow import Tally

__all__ = ["FittingTable", "brief", "live_table", "summary_table"]

WAYS: Final = {"robot": "→ cloud", "cloud": "→ robot"}


_DISPENSABLE: Final = ("encoding", "p99 ms", "drops", "Mb/s", "way", "arrived")
"""Columns that give way in a narrow terminal, the first of them first; a figure without its last digits is a lie."""

_GAP: Final = 1  # characters between two columns


class FittingTable:
    """A table that leaves out columns where the terminal is too narrow for all of them."""

    def __init__(self, title: str, *columns: str) -> None:
        self._title, self._columns = title, columns
        self._rows: list[tuple[str, ...]] = []

    def add_row(self, *cells: str) -> None:
        """Add a row with a cell for each column."""
        self._rows.append(cells)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the columns that fit."""
        shown = self.fitting(options.max_width)
        table = Table(title=self._title, title_justify="left", box=None, pad_edge=False, header_style="bold")
        table.padding = (0, _GAP, 0, 0)
        for name in shown:
            text = name in ("topic", "way", "encoding")
            table.add_column(name, justify="left" if text else "right", no_wrap=True, overflow="ellipsis")
        for row in self._rows:
            table.add_row(*(cell for name, cell in zip(self._columns, row, strict=True) if name in shown))
        yield table

    def fitting(self, width: int) -> list[str]:
        """Return the names of the columns that fit into so many characters."""
        needed = {
            name: max(len(name), *(len(row[index]) for row in self._rows)) if self._rows else len(name)
            for index, name in enumerate(self._columns)
        }
        for name in _DISPENSABLE:
            if sum(needed.values()) + _GAP * len(needed) <= width:
                break
            needed.pop(name, None)
        return list(needed)


def live_table(flows: Iterable[Tally], figures: Mapping[str, Mapping[str, Any]], seconds: float) -> FittingTable:
    """Make the table of each route's last second; ``figures`` is what the gateways report, by topic."""
    title = f"Two DDS networks, two gateways, {seconds:.0f} s"
    table = FittingTable(title, "topic", "way", "Hz", "delay ms", "Mb/s", "drops", "encoding")
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
    table = FittingTable("Summary", "topic", "way", "arrived", "Hz", "p50 ms", "p99 ms", "Mb/s", "drops")
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
