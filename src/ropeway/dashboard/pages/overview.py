"""The map of gateways, links and routes."""

from __future__ import annotations

from typing import Final

from nicegui import ui

from ropeway.dashboard.frame import Page
from ropeway.dashboard.map import MappedGateway, draw_map, shares
from ropeway.dashboard.svg import colour_of

__all__ = ["make"]

_WIDE: Final = 760.0
_NARROW: Final = 390.0


def make(page: Page) -> None:
    """Make the page."""
    with ui.row().classes("q-gutter-sm") as counts:
        pass
    # The drawing is made by svg.Drawing, which escapes all that gateways tell.
    wide = ui.html("", sanitize=False).classes("full-width gt-sm").mark("map")
    narrow = ui.html("", sanitize=False).classes("full-width lt-md")
    shown: dict[str, int] = {}

    def update() -> None:
        places = [MappedGateway(watch.key, watch.name, watch.status, watch.error) for watch in page.watches]
        wide.set_content(draw_map(places, _WIDE))
        narrow.set_content(draw_map(places, _NARROW))
        found = dict(shares(places))
        if found != shown:
            shown.clear()
            shown.update(found)
            counts.clear()
            with counts:
                for state, number in sorted(found.items()):
                    ui.badge(f"{number} {state}").style(f"background: {colour_of(state)} !important")

    page.every(update)
