"""Makes tables of the status of a gateway."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from rich.markup import escape

from ropeway.cli.fitting_table import FittingTable
from ropeway.control.figures import duration, shown_number
from ropeway.gateway.link_rows import each_link

__all__ = ["recording_table", "session_table", "tables"]

_GOOD: Final = ("active", "connected", "recording")
_BAD: Final = ("failed", "waiting to retry", "closed")


def tables(status: Mapping[str, Any]) -> Iterator[FittingTable]:
    """Yield the tables: links, routes, and clients and recorders where there are any."""
    remotes, routes, sessions = status["remotes"], status["routes"], status["sessions"]
    yield _links(status["name"], remotes)
    if routes:
        yield _routes(routes)
    if sessions:
        yield session_table(sessions)
    if status.get("recordings"):
        yield recording_table(status["recordings"])


def _links(name: str, remotes: Iterable[Mapping[str, Any]]) -> FittingTable:
    table = FittingTable(
        f"{escape(name)}: links",
        *("remote", "state", "round trip ms", "Mbit/s", "in MB", "out MB", "connections", "error"),
        dispensable=("connections", "in MB", "out MB", "Mbit/s", "round trip ms"),
        text=("remote", "state", "error"),
    )
    for address, link in each_link(remotes):
        table.add_row(
            escape(address),
            _state(link.get("state", "")),
            shown_number(link.get("rtt_ms")),
            shown_number(link.get("pace_bps"), 1e-6),
            shown_number(link.get("bytes_in"), 1e-6),
            shown_number(link.get("bytes_out"), 1e-6),
            str(link.get("connections", "-")),
            escape(link.get("error", "")),
        )
    return table


def _routes(routes: Iterable[Mapping[str, Any]]) -> FittingTable:
    table = FittingTable(
        "routes",
        *("route", "name", "state", "from", "to", "Hz", "ms", "Mbit/s", "drops", "encoding", "why"),
        dispensable=("encoding", "Mbit/s", "from", "to", "drops", "ms", "route"),
        text=("route", "name", "state", "encoding", "why"),
    )
    for route in routes:
        table.add_row(
            route["operation"],
            escape(route["name"]),
            _state(route["state"]),
            str(route.get("publishers", "-")),
            _count(route.get("readers")),
            shown_number(route.get("rate_hz")),
            shown_number(route.get("delay_ms", route.get("took_ms"))),
            shown_number(route.get("bandwidth_bps"), 1e-6),
            str(sum(route.get("drops", {}).values())),
            route.get("encoding", ""),
            escape(route["error"] or route.get("reason", "")),
        )
    return table


def session_table(sessions: Iterable[Mapping[str, Any]]) -> FittingTable:
    """Make the table of clients."""
    table = FittingTable(
        "clients",
        *("client", "kind", "role", "for", "topics", "services", "in MB", "out MB", "denied", "agent"),
        dispensable=("agent", "denied", "in MB", "out MB", "services", "role"),
        text=("client", "kind", "role", "agent"),
    )
    for session in sessions:
        table.add_row(
            escape(session["peer"]),
            escape(f"gateway {session['gateway']}" if session["gateway"] else session["dialect"]),
            escape(session["role"]),
            duration(time.time() - session["since"]),
            str(len(session["topics"])),
            str(len(session["services"])),
            shown_number(session["bytes_in"], 1e-6),
            shown_number(session["bytes_out"], 1e-6),
            str(sum(session["denied"].values())),
            escape(session["agent"]),
        )
    return table


def recording_table(recordings: Iterable[Mapping[str, Any]]) -> FittingTable:
    """Make the table of recorders."""
    table = FittingTable(
        "recorders",
        *("recorder", "state", "messages", "MB", "clips", "lost", "last", "error"),
        dispensable=("last", "lost", "clips"),
        text=("recorder", "state", "last", "error"),
    )
    for row in recordings:
        held = row.get("ring", row)
        table.add_row(
            escape(f"{row['name']} ({row['part']})" if "part" in row else row["name"]),
            _state(row["state"]),
            _figure(held.get("messages")),
            shown_number(held.get("bytes"), 1e-6),
            _figure(row.get("clips")),
            str(sum(row["dropped"].values())),
            escape(row["last"]),
            escape(row["error"]),
        )
    return table


def _figure(value: int | None) -> str:
    return "-" if value is None else str(value)


def _state(state: str) -> str:
    colour = "green" if state in _GOOD else "red" if state in _BAD else "yellow"
    return f"[{colour}]{escape(state)}[/{colour}]"


def _count(value: int | None) -> str:
    return "?" if value is None else str(value)
