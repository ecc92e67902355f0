"""``ropeway keys renew``: a new certificate in time."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.keys.common import DaysOption, FleetOption, about, describe, open_fleet
from ropeway.cli.session import JsonOption
from ropeway.errors import IdentityError
from ropeway.networks.overlay.crypto.identity import write_private

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def renew(
    name: Annotated[str, typer.Argument(help="The member's name.", show_default=False)],
    fleet: FleetOption = None,
    days: DaysOption = 365.0,
    output: Annotated[
        Path | None, typer.Option("--output", help="Write the new bundle to this file.", show_default=False)
    ] = None,
    replace: Annotated[
        Path | None, typer.Option("--replace", help="Put it in the place of this one, at once.", show_default=False)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a new bundle for NAME, with a new key and the same rights. The old one goes on until it expires."""
    path = output or replace
    if path is None or (output and replace):
        fail("say where the new bundle goes: --output FILE, or --replace FILE", 2)
    made = open_fleet(fleet)
    if replace is None and path.exists():
        raise IdentityError(str(path), "it exists already and is never overwritten; use --replace if that is intended")
    identity = made.renew(name, days=days)
    write_private(path, identity.to_text(), replace=replace is not None)
    if as_json:
        print_json({"file": str(path), **about(identity.certificate)})
    else:
        answer(describe(identity.certificate))
