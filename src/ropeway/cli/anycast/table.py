"""Draws groups as tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from ropeway.cli.console import print_json

if TYPE_CHECKING:
    from rich.console import RenderableType

__all__ = ["GroupOption", "drawn", "named", "show"]

GroupOption = Annotated[
    str, typer.Option("--group", help="Title or addresses of the group; default: the only one.", show_default=False)
]

_FIGURES: Final = ("median", "p99")
_LAST: Final = 4  # decisions below the table


def show(groups: Iterable[Mapping[str, Any]], *, as_json: bool) -> None:
    """Print groups, as tables or as one line of JSON each."""
    from rich.console import Console

    for group in groups:
        if as_json:
            print_json(group)
        else:
            Console().print(drawn(group))


def drawn(group: Mapping[str, Any]) -> RenderableType:
    """Return a group as a table of its members, with the last decisions below."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    bound = ", ".join(f"{name} {1e3 * limit:g} ms" for name, limit in group["bound_s"].items()) or "no bound"
    held = ", paused" if group["held"] else ""
    table = Table(
        title=f"{group['group']}: {group['policy']}, {bound}, {group['phase']}{held}", title_justify="left", box=None
    )
    for head in ("member", "state", "bound"):
        table.add_column(head, no_wrap=True)
    for head in (*(f"{name} ms" for name in _FIGURES), "answers", "open", "classes (ms)", "fit"):
        table.add_column(head, justify="right")
    names = {address: name for name, address in group["machines"].items()}
    for address, member in group["members"].items():
        table.add_row(names.get(address, address), *_cells(member, address == group["current"]))
    last = [Text(named(line, names)) for line in group["decisions"][-_LAST:]]
    return Group(table, *last)


def named(text: str, names: Mapping[str, str]) -> str:
    """Return a text with the names of machines in the place of their addresses."""
    for address in sorted(names, key=len, reverse=True):  # an address may begin another one
        text = text.replace(address, names[address])
    return text


def _cells(member: Mapping[str, Any], current: bool) -> list[str]:
    state = "gone" if not member["here"] else "in use" if current else "standby"
    known = member["latency_s"]
    figures = ["-"] * len(_FIGURES) if known is None else [f"{1e3 * known[name]:.1f}" for name in _FIGURES]
    classes = " ".join(f"{1e3 * one['mean']:.1f} ({100 * one['share']:.0f}%)" for one in member["classes"])
    fit = "-" if member["fit"] is None else f"{member['fit']:.2f}"
    answered = "0" if known is None else str(known["answered"])
    return [state, member["standing"], *figures, answered, str(member["in_flight"]), classes or "-", fit]
