"""The overlays that a gateway is a member of: other members, how they are reached, and routers."""

from __future__ import annotations

from typing import Any, Final

from nicegui import ui

from ropeway.dashboard.answers import LinkRow
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
        overlays = [link for link in (watch.status.remotes if watch.status is not None else ()) if link.fleet]
        about.set_text("\n".join(map(_about, overlays)) or "This gateway is a member of no overlay.")
        fill(table, [row for link in overlays for row in _rows(link)])

    page.every(update)


def _about(link: LinkRow) -> str:
    text = f"{link.fleet}: {link.state}, {len(link.gateways)} members, {len(link.routers)} routers"
    text += f"; the certificate expires {link.expires[:10]}" if link.expires else ""
    return f"{text}: {link.trouble or link.error}" if link.trouble or link.error else text


def _rows(link: LinkRow) -> list[dict[str, Any]]:
    members = [(member.name, member.gateway, member.path, str(member.names)) for member in link.gateways]
    routers = [("router", router, "linked", "") for router in link.routers]
    return [
        {
            "id": f"{link.address} {gateway}",
            "fleet": link.fleet,
            "name": name,
            "state": state,
            "colour": colour_of("active" if state in ("direct", "linked") else "idle"),
            "names": names,
            "gateway": gateway,
        }
        for name, gateway, state, names in [*members, *routers]
    ]
