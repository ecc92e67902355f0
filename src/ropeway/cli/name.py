"""``ropeway name``: the global name of a topic, service or action."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.session import JsonOption, full_name
from ropeway.errors import IdentityError, InvalidTypeName
from ropeway.graph.actions.parts import parts_of_action
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.names import Metadata, global_name
from ropeway.types.definition import canonical_name

__all__ = ["IdentityOption", "app"]

app = typer.Typer(add_completion=False)

IdentityOption = Annotated[
    Path,
    typer.Option("--identity", "-i", envvar="ROPEWAY_IDENTITY", help="A bundle, NAME.ropeway.", show_default=False),
]
_MIDDLE = {"msg": "topic", "srv": "service", "action": "action"}


@app.command("name")
def name_command(
    name: Annotated[str, typer.Argument(help="A topic, service or action.", show_default=False)],
    type: Annotated[str, typer.Argument(help="Its type, as in sensor_msgs/msg/Image.", show_default=False)],
    identity: IdentityOption,
    author: Annotated[str, typer.Option(help="Metadata that goes into the name.")] = "",
    maintainer: Annotated[str, typer.Option(help="Likewise.")] = "",
    description: Annotated[str, typer.Option(help="Likewise.")] = "",
    unique: Annotated[str, typer.Option(help="Likewise: tells deployments of one name apart.")] = "",
    node: Annotated[str, typer.Option(help="Likewise: the name of the node that has it.")] = "",
    as_json: JsonOption = False,
) -> None:
    """Print the global name of NAME: 64 hex digits that only members of the fleet can make.

    An action has five: those of the services and topics that it is made of, which are what is advertised.
    """
    middle = next((part for part in _MIDDLE if f"/{part}/" in type), "msg")
    try:
        full_type = canonical_name(type, middle)
    except InvalidTypeName as error:
        fail(str(error), 2)
    member = Identity.load(identity)
    if member.name_secret is None:
        raise IdentityError(str(identity), "it is a router's, which makes no names; take a member's bundle")
    about = Metadata(author, maintainer, description, unique, node)
    kind, full = _MIDDLE[middle], full_name(name)
    parts = parts_of_action(full, full_type) if kind == "action" else [(kind, full, full_type)]
    rows = [
        {"kind": what, "name": part, "type": of, "global": global_name(member.name_secret, what, part, of, about).hex()}
        for what, part, of in parts
    ]
    if as_json:
        print_json(
            {
                "name": full,
                "type": full_type,
                "kind": kind,
                "global": rows[0]["global"],
                **({"advertised": rows} if kind == "action" else {}),
            }
        )
    elif kind == "action":
        for row in rows:
            answer(f"{row['global']}  {row['kind']:<8}{row['name']}")
    else:
        answer(rows[0]["global"])
