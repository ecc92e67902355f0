"""Makes tables that become cards on a phone. Cells are texts to the browser, never markup."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

from nicegui import ui

from ropeway.limits import DASHBOARD_ROWS

__all__ = ["STATE_CELL", "fill", "make_table"]

STATE_CELL: Final = """<q-td :props="props"><q-badge :style="'background:' + props.row.colour">{{ props.value }}
</q-badge></q-td>"""
"""The cell of a state, in the colour that the row has."""

_CARD: Final = """<div class="q-pa-xs col-12"><q-card flat bordered class="q-pa-sm"><template v-for="col in props.cols"
:key="col.name"><div v-if="col.value" class="wraps"><span class="text-caption text-grey">{{ col.label }}</span>
{{ col.value }}</div></template></q-card></div>"""
"""Lays out a row on a phone, where a page says nothing else."""

_TOO_MANY: Final = "… and {} more"


def make_table(
    columns: Mapping[str, str], empty: str, *, slots: Mapping[str, str] | None = None, wide: Collection[str] = ()
) -> ui.table:
    """Make a table; ``columns`` has headings by key, ``wide`` those for wide screens alone."""
    described = [
        {
            "name": key,
            "label": heading,
            "field": key,
            "align": "left",
            "sortable": key not in ("spark", "more"),
            **({"classes": "gt-sm", "headerClasses": "gt-sm"} if key in wide else {}),
        }
        for key, heading in columns.items()
    ]
    table = ui.table(rows=[], columns=described, row_key="id", pagination=50).classes("full-width figures")
    table.props(f'flat dense :grid="Quasar.Screen.lt.sm" no-data-label="{empty}"')
    for name, template in {"item": _CARD, **(slots or {})}.items():
        table.add_slot(name, template)
    return table


def fill(table: ui.table, rows: Sequence[Mapping[str, Any]]) -> None:
    """Show rows, if they have changed; of too many the first."""
    shown = [dict(row) for row in rows[:DASHBOARD_ROWS]]
    if len(rows) > DASHBOARD_ROWS and table.columns:
        shown.append({"id": "more", str(table.columns[0]["name"]): _TOO_MANY.format(len(rows) - DASHBOARD_ROWS)})
    if table.rows != shown:
        table.rows = shown
