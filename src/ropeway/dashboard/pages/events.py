"""The last events of a gateway, the newest first."""

from __future__ import annotations

from collections import deque
from typing import Any, Final

from ropeway.dashboard.answers import EventRow
from ropeway.dashboard.frame import Page
from ropeway.dashboard.svg import colour_of
from ropeway.dashboard.tables import STATE_CELL, fill, make_table
from ropeway.dashboard.texts import at
from ropeway.limits import DASHBOARD_ROWS

__all__ = ["make"]

_COLUMNS: Final = {"time": "time", "kind": "kind", "name": "name", "state": "state", "why": "why"}


def make(page: Page) -> None:
    """Make the page."""
    table = make_table(_COLUMNS, "Nothing has happened.", slots={"body-cell-state": STATE_CELL})
    kept: deque[EventRow] = deque(maxlen=DASHBOARD_ROWS)

    async def update() -> None:
        last = kept[0].number if kept else 0
        found = await page.fetch(list[EventRow], "/v1/events", after=last)
        if found:
            kept.extendleft(found)
            fill(table, [_row(event) for event in kept])
        elif found is None:
            kept.clear()  # numbers begin anew with another process

    page.every(update)


def _row(event: EventRow) -> dict[str, Any]:
    before = f"before: {event.before}" if event.before else ""
    who = f"by {event.who}" if event.who else ""
    return {
        "id": event.number,
        "time": at(event.time),
        "kind": event.kind,
        "name": event.name,
        "state": event.state or event.action,
        "colour": colour_of(event.state),
        "why": ", ".join(filter(None, (event.why, who, before))),
    }
