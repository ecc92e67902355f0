"""The overlays that a gateway is a member of: other members, how they are reached, and routers."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import starmap
from typing import Any, Final

from nicegui import ui

from ropeway.dashboard.answers import LinkRow, OverlayRow
from ropeway.dashboard.frame import Page
from ropeway.dashboard.svg import colour_of
from ropeway.dashboard.tables import STATE_CELL, fill, make_table

__all__ = ["make"]

_COLUMNS: Final = {
    "fleet": "fleet",
    "name": "member",
    "state": "reached",
    "names": "names",
    "gateway": "identity",
}


def make(page: Page) -> None:
    """Make the page."""
    watch = page.watch
    if watch is None:
        return
    about = ui.label().classes("wraps full-width")
    table = make_table(
        _COLUMNS, "No other member is known.", slots={"body-cell-state": STATE_CELL}, wide=("gateway", "fleet")
    )

    def update() -> None:
        links = watch.status.remotes if watch.status is not None else ()
        overlays = [(link, link.overlay) for link in links if link.overlay is not None]
        about.set_text("\n".join(starmap(_about, overlays)) or "This gateway is a member of no overlay.")
        fill(table, [row for link, overlay in overlays for row in _rows(link.address, overlay)])

    page.every(update)


def _about(link: LinkRow, overlay: OverlayRow) -> str:
    others, routers = _count(overlay.gateways, "other member"), _count(overlay.routers, "router")
    text = f"{overlay.fleet}: {link.state}, {others}, {routers}"
    text += f"; the certificate expires {overlay.expires[:10]}" if overlay.expires else ""
    return f"{text}: {overlay.trouble or link.error}" if overlay.trouble or link.error else text


def _count(listed: Sequence[object], word: str) -> str:
    return f"{len(listed)} {word}{'' if len(listed) == 1 else 's'}"


def _rows(address: str, overlay: OverlayRow) -> list[dict[str, Any]]:
    members = [(member.name, member.gateway, member.path, str(member.names)) for member in overlay.gateways]
    routers = [("router", router, "linked", "") for router in overlay.routers]
    return [
        {
            "id": f"{address} {gateway}",
            "fleet": overlay.fleet,
            "name": name,
            "state": state,
            "colour": colour_of("active" if state in ("direct", "linked", "routed") else "idle"),
            "names": names,
            "gateway": gateway,
        }
        for name, gateway, state, names in [*members, *routers]
    ]
