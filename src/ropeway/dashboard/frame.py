"""The frame of every page: heading, navigation, choice of the gateway, and the clock by which a page is brought up to
date.
"""

from __future__ import annotations

import asyncio
import contextlib
import inspect
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, TypeVar
from urllib.parse import urlencode

from nicegui import ui

from ropeway.aio import timeout
from ropeway.dashboard.answers import read
from ropeway.dashboard.guard import LOGIN_PATH
from ropeway.dashboard.login import LOGOUT_PATH
from ropeway.errors import RopewayError
from ropeway.tasks import describe

if TYPE_CHECKING:
    from ropeway.dashboard.viewers import Viewer
    from ropeway.dashboard.watch import GatewayWatch
    from ropeway.dashboard.watch_list import WatchList

__all__ = ["Page", "PageEntry", "add_styles", "build"]

T = TypeVar("T")

_PERIOD_S: Final = 1.0
_FIRST_S: Final = 0.4
"""How long the first picture waits for gateways: one that is away must not hold it up."""
_READ_S: Final = 60.0
"""How long a browser may take for one change of a page, before the next is tried."""
_STYLES: Final = """
body {font-family: system-ui, sans-serif} a {color: inherit; text-decoration: none}
.nicegui-content {max-width: 1200px; margin: auto; gap: 12px}
svg[role=img] {width: 100%; height: auto; display: block} svg a:hover rect {fill-opacity: .2}
svg text {paint-order: stroke; stroke: var(--q-paper, #fff); stroke-width: 3px}
.body--dark {--q-paper: #121212} .wraps {overflow-wrap: anywhere; white-space: pre-wrap}
.figures {font-variant-numeric: tabular-nums} .q-table td {overflow-wrap: anywhere; white-space: normal}
.q-table td:first-child {min-width: 110px}
.plot {max-width: 760px} .q-table__grid-item-value {overflow-wrap: anywhere}
"""


@dataclass(frozen=True)
class PageEntry:
    """A page: its title, its path, its icon, and what makes its content."""

    title: str
    path: str
    icon: str
    make: Callable[[Page], None]
    period_s: float = _PERIOD_S
    listed: bool = True


@dataclass
class Page:
    """A page that a viewer looks at. ``watch`` is the gateway that was chosen; ``None`` where there is none."""

    viewer: Viewer
    fleet: WatchList
    watches: list[GatewayWatch]
    watch: GatewayWatch | None
    query: dict[str, str]
    updates: list[Callable[[], Any]] = field(default_factory=list)
    trouble: str = ""
    ticks: int = 0

    def every(self, update: Callable[[], Any]) -> None:
        """Call ``update`` with each tick of the page, while the browser keeps up; one that is no coroutine also now."""
        self.updates.append(update)
        if not inspect.iscoroutinefunction(update):
            update()

    async def do(self, question: Callable[[], Awaitable[Any]], done: str = "") -> Any:
        """Return an answer of the gateway, and say that it is ``done``; an error is shown, and ``None`` returned."""
        if not self.viewer.active:
            return None
        try:
            answer = await question()
        except RopewayError as error:
            ui.notify(describe(error), type="negative", multi_line=True, timeout=10_000, close_button="Close")
            return None
        if done:
            ui.notify(done, type="positive")
        return answer

    async def fetch(self, shape: type[T], path: str, **query: Any) -> T | None:
        """Return what the chosen gateway has at a path; an error is shown above the page, and ``None`` returned."""
        if self.watch is None or self.watch.error or not self.viewer.active:
            return None
        try:
            found = read(shape, await self.watch.client.get(path, **query))
        except RopewayError as error:
            self.trouble = describe(error)
            return None
        self.trouble = ""
        return found

    def button(
        self, text: str, right: str, press: Callable[[], Any], *, icon: str | None = None, colour: str = "primary"
    ) -> ui.button:
        """Make a button; without the ``right`` at the gateway it cannot be pressed, and says why."""
        made = ui.button(text, on_click=press, icon=icon, color=colour).props("no-caps")
        watch = self.watch
        if watch is not None and not watch.may(right):
            made.disable()
            with made:
                ui.tooltip(f'{watch.caller.name or "this login"} lacks the right "{right}"')
        return made

    def link(self, path: str, **query: str) -> str:
        """Return the address of a page about the gateway that was chosen."""
        chosen = {} if self.watch is None else {"gateway": self.watch.key}
        return f"{path}?{urlencode({**chosen, **query})}"


async def build(
    entry: PageEntry, entries: Sequence[PageEntry], viewer: Viewer, fleet: WatchList, query: dict[str, str]
) -> None:
    """Make a page."""
    watches = fleet.watches(viewer.token)
    chosen = next((watch for watch in watches if watch.key == query.get("gateway")), None)
    await _first_answers(watches)
    page = Page(viewer, fleet, watches, chosen or _main(watches), query)
    _head(page, entry, entries)
    entry.make(page)
    timer = ui.timer(entry.period_s, lambda: _tick(page, timer))


def _main(watches: Sequence[GatewayWatch]) -> GatewayWatch | None:
    """Return the gateway to show where none was chosen: the first with routes of its own."""
    with_routes = (watch for watch in watches if watch.status is not None and watch.status.routes)
    return next(with_routes, watches[0] if watches else None)


async def _first_answers(watches: Sequence[GatewayWatch]) -> None:
    for watch in watches:
        watch.look()
    with contextlib.suppress(TimeoutError):
        async with timeout(_FIRST_S):
            await asyncio.gather(*(watch.answered.wait() for watch in watches))


async def _tick(page: Page, timer: ui.timer) -> None:
    """Bring a page up to date, and wait until the browser has taken it: to one that stalls no more is sent."""
    if not page.viewer.active:
        timer.cancel()
        ui.navigate.to(LOGIN_PATH)
        return
    for watch in page.watches:
        watch.look()
    for update in page.updates:
        done = update()
        if isinstance(done, Awaitable):
            await done
    page.ticks += 1
    with contextlib.suppress(TimeoutError):
        await ui.run_javascript("0", timeout=_READ_S)


def _head(page: Page, entry: PageEntry, entries: Sequence[PageEntry]) -> None:
    ui.page_title(f"Ropeway: {entry.title.lower()}")
    drawer = ui.left_drawer(value=False, bordered=True).props("breakpoint=900 width=200 show-if-above")
    with drawer:
        for each in filter(lambda each: each.listed, entries):
            with ui.item().props(f'clickable {"active" if each is entry else ""} href="{page.link(each.path)}"'):
                with ui.item_section().props("avatar"):
                    ui.icon(each.icon)
                with ui.item_section():
                    ui.label(each.title)
        with ui.element("form").props(f"method=post action={LOGOUT_PATH}"):
            ui.button("Log out", icon="logout").props("flat no-caps type=submit")
    with ui.header().classes("items-center q-py-xs no-wrap"):
        ui.button(icon="menu", on_click=drawer.toggle).props('flat dense color=white aria-label="Menu"')
        ui.label(entry.title).classes("text-h6")
        ui.space()
        if len(page.watches) > 1:
            chosen = {watch.key: watch.key for watch in page.watches}
            ui.select(
                chosen,
                value=page.watch.key if page.watch is not None else None,
                on_change=lambda event: ui.navigate.to(f"{entry.path}?{urlencode({'gateway': event.value})}"),
            ).props('dense dark outlined options-dense aria-label="Gateway"')
        elif page.watch is not None:
            ui.label(page.watch.name)
    _trouble(page)


def _trouble(page: Page) -> None:
    """Show which gateways do not answer."""
    banner = ui.label().classes("bg-negative text-white q-pa-sm full-width wraps").style("border-radius: 8px")
    banner.mark("trouble")

    def update() -> None:
        lines = [f"{watch.key}: {watch.error}" for watch in page.watches if watch.error]
        text = "\n".join([*lines, page.trouble] if page.trouble else lines)
        if not page.watches:
            text = "No gateway runs on this machine, and none was named: ropeway dashboard https://robot:9191"
        banner.set_text(text)
        banner.set_visibility(bool(text))

    page.every(update)


def add_styles() -> None:
    """Add the style of all pages."""
    ui.add_css(_STYLES, shared=True)
