"""The audit log of a gateway: who changed, commanded, was denied or disconnected, the newest entry first."""

from __future__ import annotations

from typing import Any, Final

from nicegui import ui

from ropeway.dashboard.answers import AuditPageAnswer, AuditRow, read
from ropeway.dashboard.frame import Page
from ropeway.dashboard.tables import fill, make_table
from ropeway.dashboard.texts import at
from ropeway.errors import RopewayError
from ropeway.tasks import describe

__all__ = ["make"]

_COLUMNS: Final = {
    "time": "time",
    "kind": "kind",
    "operation": "operation",
    "name": "name",
    "who": "who",
    "where": "from",
    "outcome": "outcome",
    "why": "why",
    "times": "times",
}
_COUNT: Final = 200


def make(page: Page) -> None:
    """Make the page."""
    watch = page.watch
    about = ui.label().classes("wraps text-caption")
    table = make_table(_COLUMNS, "There is no entry.", wide=("where", "times"))

    async def update() -> None:
        if watch is None or watch.error:
            return
        try:
            found = read(AuditPageAnswer, await watch.client.get("/v1/audit", count=_COUNT))
        except RopewayError as error:
            about.set_text(f"The audit log cannot be shown: {describe(error)}")
            return
        lost = f"{found.lost} entries were lost" if found.lost else ""
        about.set_text("; ".join(filter(None, (lost, found.error))))
        fill(table, [_row(entry) for entry in reversed(found.entries)])

    page.every(update)


def _row(entry: AuditRow) -> dict[str, Any]:
    return {**entry.model_dump(), "id": entry.number, "time": at(entry.time)}
