"""``ropeway store rm``: forget a value."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.session import JsonOption
from ropeway.cli.store.source import AtOption, CaOption, TokenOption, find_source, key_of

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("rm")
def remove(
    names: Annotated[list[str], typer.Argument(help="SYSTEM/TOPIC, one or more.", show_default=False)],
    at: AtOption = "http://127.0.0.1:9090",
    token: TokenOption = "",
    ca: CaOption = "",
    as_json: JsonOption = False,
) -> None:
    """Forget the last value of topics, and their history."""
    keys = [key_of(name) for name in names]
    if any("*" in key for key in keys):
        fail("name topics one by one, as PEPPER/cmd_vel: a pattern removes nothing", 2)
    source = find_source(at, token, ca)
    try:
        gone = [(system, topic, source.remove(system, topic)) for system, topic in keys]
    finally:
        source.close()
    for system, topic, there in gone:
        if as_json:
            print_json({"system": system, "topic": topic, "removed": there})
        else:
            answer(f"{system}/{topic} {'is forgotten' if there else 'was not there'}")
    if not all(there for _, _, there in gone):
        raise typer.Exit(1)
