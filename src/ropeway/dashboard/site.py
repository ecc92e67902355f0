"""All pages of the dashboard, and the application that serves them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Final

from fastapi import FastAPI
from nicegui import ui
from starlette.requests import Request
from starlette.types import ASGIApp

from ropeway.dashboard.frame import PageEntry, add_styles, build
from ropeway.dashboard.guard import Guard, viewer_of
from ropeway.dashboard.login import Login
from ropeway.dashboard.pages import (
    audit,
    configuration,
    drive,
    events,
    groups,
    overlay,
    overview,
    routes,
    sessions,
    store,
    topic,
    topics,
)

if TYPE_CHECKING:
    from ropeway.dashboard.viewers import Viewers
    from ropeway.dashboard.watch_list import WatchList
    from ropeway.listener.hosts import Hosts

__all__ = ["ENTRIES", "make_site"]

ENTRIES: Final = (
    PageEntry("Map", "/", "hub", overview.make),
    PageEntry("Routes", "/routes", "alt_route", routes.make),
    PageEntry("Topics", "/topics", "podcasts", topics.make),
    PageEntry("Topic", "/topic", "insights", topic.make, period_s=0.4, listed=False),
    PageEntry("Drive", "/drive", "sports_esports", drive.make),
    PageEntry("Configuration", "/configuration", "tune", configuration.make),
    PageEntry("Clients", "/sessions", "devices", sessions.make),
    PageEntry("Overlay", "/overlay", "lan", overlay.make),
    PageEntry("Groups", "/groups", "group_work", groups.make),
    PageEntry("Store", "/store", "inventory_2", store.make),
    PageEntry("Events", "/events", "history", events.make),
    PageEntry("Audit", "/audit", "policy", audit.make),
)

_MOST_MESSAGES: Final = 50
"""Changes that are kept for a browser whose connection broke; it gets the whole page anew where they do not do."""
_RECONNECT_S: Final = 5.0


def make_site(fleet: WatchList, viewers: Viewers, hosts: Hosts, *, secure: bool = False) -> ASGIApp:
    """Make the application. NiceGUI knows one per process."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    app.router.routes += Login(viewers, fleet, secure=secure).routes()
    for entry in ENTRIES:
        ui.page(entry.path)(_page(entry, fleet))
    add_styles()
    ui.run_with(
        app,
        title="Ropeway",
        dark=None,
        tailwind=False,
        reconnect_timeout=_RECONNECT_S,
        message_history_length=_MOST_MESSAGES,
        show_welcome_message=False,
    )
    return Guard(app, viewers, hosts)


def _page(entry: PageEntry, fleet: WatchList) -> Callable[[Request], Awaitable[None]]:
    async def page(request: Request) -> None:
        await build(entry, ENTRIES, viewer_of(request.scope), fleet, dict(request.query_params))

    page.__annotations__["request"] = Request  # FastAPI reads it, where postponed annotations are texts
    return page
