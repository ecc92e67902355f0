"""``ropeway interface list``: the interfaces that are known here."""

from __future__ import annotations

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.interface.common import KINDS, ActionsOption, MessagesOption, ServicesOption, chosen_kinds
from ropeway.cli.session import JsonOption, TypesOption, known_types

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("list")
def list_interfaces(
    only_msgs: MessagesOption = False,
    only_srvs: ServicesOption = False,
    only_actions: ActionsOption = False,
    types: TypesOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the interfaces: bundled ones, those of a sourced ROS 2, and those of --types."""
    registry = known_types(types)
    names = {
        kind: registry.names(kind)
        for kind in chosen_kinds(messages=only_msgs, services=only_srvs, actions=only_actions)
    }
    if as_json:
        print_json(names)
        return
    for kind, found in names.items():
        answer("\n".join([f"{KINDS[kind]}:", *(f"    {name}" for name in found)]))
