"""``ropeway interface package``: the interfaces of one package."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.interface.common import ActionsOption, MessagesOption, ServicesOption, chosen_kinds
from ropeway.cli.session import JsonOption, TypesOption, known_types

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("package")
def package(
    name: Annotated[str, typer.Argument(metavar="PACKAGE", help="Such as sensor_msgs.", show_default=False)],
    only_msgs: MessagesOption = False,
    only_srvs: ServicesOption = False,
    only_actions: ActionsOption = False,
    types: TypesOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the interfaces of PACKAGE."""
    known = [one for one in known_types(types).names() if one.startswith(f"{name}/")]
    if not known:
        fail(f"Unknown package {name!r}; see `ropeway interface packages`, or name its files with --types")
    kinds = chosen_kinds(messages=only_msgs, services=only_srvs, actions=only_actions)
    found = [one for kind in kinds for one in known if one.split("/")[1] == kind]
    if as_json:
        print_json(found)
    else:
        answer("\n".join(found))
