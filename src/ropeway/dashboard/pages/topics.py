"""The topics on the networks of a gateway."""

from __future__ import annotations

from typing import Final

from nicegui import ui

from ropeway.dashboard.answers import TopicRow
from ropeway.dashboard.frame import Page
from ropeway.dashboard.tables import fill, make_table

__all__ = ["make"]

_COLUMNS: Final = {"name": "name", "type": "type", "publishers": "publishers", "readers": "readers", "graph": "network"}
_NAME_CELL: Final = """<q-td :props="props"><a :href="props.row.href" class="text-primary">{{ props.value }}
</a></q-td>"""
_CARD: Final = """<div class="q-pa-xs col-12"><q-card flat bordered class="q-pa-sm"><a :href="props.row.href"
class="text-primary text-weight-medium wraps">{{ props.row.name }}</a><div class="text-caption wraps">
{{ props.row.type }}: {{ props.row.publishers }} publishers, {{ props.row.readers }} readers, {{ props.row.graph }}
</div></q-card></div>"""


def make(page: Page) -> None:
    """Make the page."""
    slots = {"body-cell-name": _NAME_CELL, "item": _CARD}
    search = ui.input(placeholder="Find").props("dense clearable")
    table = make_table(_COLUMNS, "No topic is there.", slots=slots, wide=("graph",))

    search.on_value_change(lambda event: table.set_filter(event.value))

    async def update() -> None:
        found = await page.fetch(list[TopicRow], "/v1/topics")
        if found is not None:
            fill(table, [_row(page, topic, number) for number, topic in enumerate(found)])

    page.every(update)


def _row(page: Page, topic: TopicRow, number: int) -> dict[str, object]:
    href = page.link("/topic", name=topic.name, graph=topic.graph)
    return {"id": number, "href": href, **topic.model_dump(), "graph": topic.graph.partition("?")[0]}
