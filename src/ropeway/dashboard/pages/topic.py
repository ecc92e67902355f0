"""A topic: its rate, its newest message as text, its numbers as a plot, its picture."""

from __future__ import annotations

import json
from typing import Final

from nicegui import ui

from ropeway.control.figures import shown_number
from ropeway.dashboard.answers import ValueAnswer, read
from ropeway.dashboard.frame import Page
from ropeway.dashboard.history import KEPT_VALUES, Histories
from ropeway.dashboard.plot import COLOURS, draw_plot, numbers_of
from ropeway.dashboard.watch import GatewayWatch
from ropeway.errors import ControlRefused, RopewayError
from ropeway.tasks import describe

__all__ = ["make"]

_FIRST_LINES: Final = 3
_DULL: Final = ("header.", "covariance", "stamp.", "layout.")
_WIDTH: Final = 560.0


def make(page: Page) -> None:
    """Make the page."""
    watch, name = page.watch, page.query.get("name", "")
    if watch is None or not name:
        ui.label("Choose a topic on the page of topics.")
        return
    _TopicView(page, watch, name, page.query.get("graph", ""))


class _TopicView:
    """The elements of the page, and what has come so far."""

    def __init__(self, page: Page, watch: GatewayWatch, name: str, graph: str) -> None:
        self._watch, self._name, self._graph = watch, name, graph
        self._count = 0
        self._numbers = Histories()
        self._known: list[str] = []
        ui.label(name).classes("text-h6 wraps")
        self._about = ui.label("waiting for a message").classes("text-caption wraps")
        self._picture = ui.element("img").style("max-width: 100%; image-rendering: pixelated; min-width: 50%")
        self._picture.props('alt="picture of the newest message"').set_visibility(False)
        self._plot = ui.html("", sanitize=False).classes("full-width plot").mark("plot")  # made by svg.Drawing
        self._chosen = ui.select([], multiple=True, label="Plotted fields", value=[]).classes("full-width")
        self._chosen.props("use-chips dense").set_visibility(False)
        self._text = ui.label().classes("wraps full-width").style("font-family: monospace; font-size: 12px")
        page.every(self._update)

    async def _update(self) -> None:
        if self._watch.error:  # shown above the page; a wrong token that is shown again and again is locked out
            return
        try:
            query = {"name": self._name, "graph": self._graph, "after": self._count}
            found = read(ValueAnswer, await self._watch.client.get("/v1/topics/value", **query))
        except RopewayError as error:
            self._about.set_text(describe(error))
            if isinstance(error, ControlRefused):
                self._count = 0
            return
        figures = f"{shown_number(found.rate_hz)} Hz, {shown_number(found.bandwidth_bps, 1e-6)} Mbit/s"
        self._about.set_text(f"{found.type}: {found.count} messages, {figures}, {found.bytes} bytes")
        if found.count > self._count:
            self._show(found)
        self._count = found.count

    def _show(self, found: ValueAnswer) -> None:
        if found.error:
            self._text.set_text(found.error)
            return
        self._text.set_text(json.dumps(found.value, indent=1, ensure_ascii=False))
        self._picture.set_visibility(found.picture is not None)
        if found.picture is not None:
            self._picture.props["src"] = f"data:{found.picture.media_type};base64,{found.picture.base64}"
            self._picture.update()
            return
        numbers = dict(numbers_of(found.value))
        self._numbers.add(numbers)
        self._offer(list(numbers))
        lines = {path: list(self._numbers.of(path)) for path in list(self._chosen.value)[: len(COLOURS)]}
        self._plot.set_content(draw_plot(lines, _WIDTH, KEPT_VALUES) if lines else "")

    def _offer(self, paths: list[str]) -> None:
        if paths == self._known:
            return
        first = [path for path in paths if not any(dull in path for dull in _DULL)]
        chosen = [path for path in self._chosen.value if path in paths] if self._known else first[:_FIRST_LINES]
        self._known = paths
        self._chosen.set_options(paths, value=chosen)
        self._chosen.set_visibility(bool(paths))
