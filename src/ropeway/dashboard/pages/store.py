"""The last values that a gateway keeps."""

from __future__ import annotations

from typing import Final

from nicegui import ui

from ropeway.control.figures import duration
from ropeway.dashboard.answers import StoreRow
from ropeway.dashboard.frame import Page
from ropeway.dashboard.tables import fill, make_table

__all__ = ["make"]

_COLUMNS: Final = {
    "system": "system",
    "topic": "topic",
    "text": "value",
    "age": "age",
    "bytes": "bytes",
    "type": "type",
    "origin": "from",
}


def make(page: Page) -> None:
    """Make the page."""
    watch = page.watch
    if watch is None:
        return
    about = ui.label().classes("wraps text-caption")
    table = make_table(_COLUMNS, "Nothing is kept.", wide=("type", "origin"))

    async def update() -> None:
        store = watch.status.store if watch.status is not None else None
        if store is None:
            about.set_text("This gateway has no store." if watch.status is not None else "")
        else:
            fault = f"; {store['fault']}" if store.get("fault") else ""
            about.set_text(f"{store.get('url', '')}, values: {store.get('values', '?')}{fault}")
        found = await page.fetch(list[StoreRow], "/v1/store")
        if found is not None:
            fill(table, [_row(value) for value in found])

    page.every(update)


def _row(value: StoreRow) -> dict[str, str]:
    return {
        **value.model_dump(include={"system", "topic", "type", "origin", "text"}),
        "id": f"{value.system}/{value.topic}",
        "age": duration(value.age_s),
        "bytes": str(value.bytes),
    }
