"""``ropeway keys revoke``: a member is one no longer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.keys.common import FleetOption, open_fleet
from ropeway.cli.loop import run
from ropeway.cli.session import JsonOption
from ropeway.extras import require
from ropeway.networks.overlay.crypto.identity import Identity

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def revoke(
    name: Annotated[str, typer.Argument(help="The member's name.", show_default=False)],
    fleet: FleetOption = None,
    push: Annotated[
        Path | None,
        typer.Option("--push", help="A bundle with which to tell the running overlay.", show_default=False),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Revoke all certificates of NAME. With --push running routers and gateways know within a minute.

    Where nobody could be told, the same command again tells them.

    Without it, give crl.pem of the fleet to the routers (ropeway router --crl), which tell everybody else.
    """
    made = open_fleet(fleet)
    identity = Identity.load(push) if push is not None else None
    again = identity is not None and made.is_revoked(name)
    serials = [] if again else made.revoke(name)
    told = None
    if identity is not None:
        require("overlay", "--push")
        from ropeway.networks.overlay.router import push_crl  # loads Zenoh

        told = run(push_crl(identity, made.crl_der()))
    if as_json:
        print_json({"name": name, "revoked": [f"{serial:x}" for serial in serials], "told": told})
        return
    how = "it was before" if again else f"{len(serials)} certificate{'s' if len(serials) != 1 else ''}"
    answer(f"{name} is revoked ({how}).")
    if told is None:
        answer(f"Nobody was told: push it with --push BUNDLE, or give {made.directory / 'crl.pem'} to the routers.")
    else:
        answer(f"{told} routers and gateways know it now and tell the others.")
