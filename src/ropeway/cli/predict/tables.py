"""Shows predictions as tables: one per link and way, a row per topic, a column per encoding."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from ropeway.cli.fitting_table import FittingTable, print_table
from ropeway.planning.plan import Way
from ropeway.planning.prediction import CONFIGURED, DDS, Prediction

__all__ = ["print_tables"]

_NAMES: Final = {DDS: "DDS", "none": "json"}


def print_tables(rows: Sequence[Prediction]) -> None:
    """Print a table per way."""
    for way in dict.fromkeys(row.way for row in rows):
        print_table(_table(way, [row for row in rows if row.way == way]))


def _table(way: Way, rows: list[Prediction]) -> FittingTable:
    carried = rows[0].rate_of_link_bps / 1e6
    encodings = list(dict.fromkeys(row.encoding for row in rows))
    totals = {encoding: next(row for row in rows if row.encoding == encoding) for encoding in encodings}
    delayed = CONFIGURED if CONFIGURED in encodings else encodings[-1]
    heads = [_NAMES.get(encoding, encoding) for encoding in encodings]
    table = FittingTable(
        f"{way[0]} → {way[1]}, {carried:g} Mbit/s: rates in Hz, red where the link is too narrow",
        *("topic", "source", *heads, f"{delayed} ms"),
        dispensable=("cbor", "zip", f"{delayed} ms", "rawzip", "cbor-raw", "zstd", "json"),
    )
    for topic in dict.fromkeys(row.topic for row in rows):
        found = {row.encoding: row for row in rows if row.topic == topic}
        cells = (_rate(found[encoding]) for encoding in encodings)
        table.add_row(topic, f"{found[encodings[0]].published_hz:.3g}", *cells, _delay(found[delayed]))
    table.add_row("all, Mbit/s", "", *(_total(totals[encoding]) for encoding in encodings), "")
    return table


def _rate(row: Prediction) -> str:
    rate = f"{row.shared_hz:.3g}"
    return f"[red]{rate}[/red]" if row.shared_hz < row.published_hz else rate


def _delay(row: Prediction) -> str:
    if row.delay_s is None or row.most_delay_s is None:
        return "grows"
    least, most = 1e3 * row.delay_s, 1e3 * row.most_delay_s
    return f"{least:.2g}" if most - least < 0.05 else f"{least:.2g}-{most:.2g}"


def _total(row: Prediction) -> str:
    text = f"{row.link_bps / 1e6:.{0 if row.link_bps > 1e9 else 1}f}"
    return text if row.fits else f"[red]{text}[/red]"
