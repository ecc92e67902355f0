"""The groups of a gateway: the latency window of each member, which is in use; and buttons to command the scheduler."""

from __future__ import annotations

from collections.abc import Callable
from textwrap import wrap
from typing import Final

from nicegui import ui

from ropeway.control.figures import shown_number
from ropeway.dashboard.answers import GroupRow, MemberRow
from ropeway.dashboard.frame import Page
from ropeway.dashboard.svg import Drawing, colour_of
from ropeway.dashboard.texts import fitted

__all__ = ["draw_windows", "make"]

_WIDTH: Final = 560.0
_NARROW: Final = 340.0
"""The width of drawings for phones, so that their letters are as large as elsewhere."""
_LEFT: Final = 0.32  # of the width
_ROW: Final = 32.0
_LINE: Final = 14.0
_LETTER: Final = 5.6  # the width of one of size 10, with room to spare
_IN_USE: Final = "#1d4ed8"


def make(page: Page) -> None:
    """Make the page."""
    if page.watch is None:
        return
    column = ui.column().classes("full-width")
    shown: dict[str, _GroupView] = {}
    with column:
        empty = ui.label("This gateway has no group.")

    async def update() -> None:
        found = await page.fetch(list[GroupRow], "/v1/anycast")
        if found is None:
            return
        empty.set_visibility(not found)
        if [group.group for group in found] != list(shown):
            shown.clear()
            column.clear()
            with column:
                for group in found:
                    shown[group.group] = _GroupView(page, group)
        for group in found:
            shown[group.group].update(group)

    page.every(update)


class _GroupView:
    """A group on the page."""

    def __init__(self, page: Page, group: GroupRow) -> None:
        self._page, self._group = page, group
        with ui.card().classes("full-width"):
            ui.label(group.group).classes("text-h6 wraps")
            self._about = ui.label().classes("text-caption wraps")
            self._drawing = ui.html("", sanitize=False).classes("full-width gt-sm").style("max-width: 760px")
            self._narrow = ui.html("", sanitize=False).classes("full-width lt-md")  # both are made by svg.Drawing
            with ui.row():
                page.button("Profile", "operate", self._press("profile"), icon="speed")
                page.button("Pause or go on", "operate", self._press("pause"), icon="pause")
                self._member = ui.select([], label="Member").props("dense").style("min-width: 160px")
                page.button("Use it", "operate", self._press("switch"), icon="swap_horiz")
            self._decisions = ui.label().classes("text-caption wraps")

    def update(self, group: GroupRow) -> None:
        """Show the group as it is now."""
        self._group = group
        held = ", paused" if group.held else ""
        self._about.set_text(f"policy {group.policy}, {group.phase}{held}, in use: {group.current or 'none'}")
        self._drawing.set_content(draw_windows(group, _WIDTH))
        self._narrow.set_content(draw_windows(group, _NARROW))
        self._decisions.set_text("\n".join(group.decisions))
        if list(group.members) != self._member.options:
            self._member.set_options(list(group.members))

    def _press(self, command: str) -> Callable[[], object]:
        async def press() -> None:
            watch, group = self._page.watch, self._group
            assert watch is not None
            body: dict[str, object] = {"group": group.group}
            if command == "switch":
                if self._member.value is None:
                    ui.notify("Choose a member first.")
                    return
                body["member"] = self._member.value
            if command == "pause":
                body["paused"] = not group.held
            await self._page.do(lambda: watch.client.post(f"/v1/anycast/{command}", body), "done")

        return press


def draw_windows(group: GroupRow, width: float) -> str:
    """Return the latency windows of the members as SVG: from the least to the 99th percentile, a mark at the median."""
    drawing = Drawing(width)
    most = max((m.latency_s.p99 for m in group.members.values() if m.latency_s is not None), default=0.0) or 1.0
    left, y = _LEFT * width, 16.0
    for name, member in group.members.items():
        colour = _IN_USE if name == group.current else colour_of("idle" if member.here else "gone")
        drawing.text(0, y, fitted(name, int(left / 6.5)), size=12, colour=colour, bold=name == group.current)
        latency = member.latency_s
        if latency is not None:
            scale = (width - left - 10) / most
            drawing.box(
                left + latency.min * scale, y - 10, max((latency.p99 - latency.min) * scale, 2), 12, colour=colour
            )
            middle = left + latency.median * scale
            drawing.curve([(middle, y - 12), (middle, y + 4)], colour=colour)
        for line in wrap(_words(member), int(width / _LETTER)):
            y += _LINE
            drawing.text(0, y, line, size=10)
        y += _ROW
    return drawing.written()


def _words(member: MemberRow) -> str:
    if not member.here:
        return "not there"
    latency = member.latency_s
    if latency is None:
        return f"{member.standing}: nothing is known"
    names = ("min", "median", "mean", "p99", "max")
    figures = [f"{name} {shown_number(1e3 * getattr(latency, name))}" for name in names]
    return f"{member.standing}: {', '.join(figures)} ms, {latency.answered} answered, {latency.pending} wait"
