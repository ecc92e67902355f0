"""``ropeway interface packages``: the packages whose interfaces are known here."""

from __future__ import annotations

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.interface.common import ActionsOption, MessagesOption, ServicesOption, chosen_kinds
from ropeway.cli.session import JsonOption, TypesOption, known_types

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("packages")
def packages(
    only_msgs: MessagesOption = False,
    only_srvs: ServicesOption = False,
    only_actions: ActionsOption = False,
    types: TypesOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the packages that have interfaces, of the chosen kinds."""
    registry = known_types(types)
    kinds = chosen_kinds(messages=only_msgs, services=only_srvs, actions=only_actions)
    found = sorted({name.partition("/")[0] for kind in kinds for name in registry.names(kind)})
    if as_json:
        print_json(found)
    else:
        answer("\n".join(found))
