"""``ropeway keys issue``: a new member or router."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.keys.common import (
    ConnectOption,
    DaysOption,
    FleetOption,
    MayCall,
    MayOffer,
    MayPublish,
    MaySubscribe,
    RouterOption,
    about,
    describe,
    open_fleet,
    rights_of,
)
from ropeway.cli.session import JsonOption
from ropeway.errors import IdentityError
from ropeway.networks.overlay.crypto.identity import write_private

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def issue(
    name: Annotated[str, typer.Argument(help="The member's name.", show_default=False)],
    fleet: FleetOption = None,
    router: RouterOption = False,
    may_publish: MayPublish = None,
    may_subscribe: MaySubscribe = None,
    may_call: MayCall = None,
    may_offer: MayOffer = None,
    days: DaysOption = 365.0,
    connect: ConnectOption = None,
    output: Annotated[
        Path | None, typer.Option("--output", help="The file; by default, NAME.ropeway.", show_default=False)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write the bundle of a new member: certificate, key, name secret, routers. It may do everything, unless told."""
    made = open_fleet(fleet)
    path = output or Path(f"{name}.ropeway")
    if path.exists():
        raise IdentityError(str(path), "it exists already and is never overwritten; name another with --output")
    identity = made.issue(
        name,
        role="router" if router else "member",
        rights=rights_of(may_publish, may_subscribe, may_call, may_offer),
        days=days,
        routers=connect or (),
    )
    write_private(path, identity.to_text())
    if as_json:
        print_json({"file": str(path), **about(identity.certificate)})
    else:
        answer(describe(identity.certificate))
        answer(f"{path} holds its private key: bring it to {name}, and to nobody else.")
