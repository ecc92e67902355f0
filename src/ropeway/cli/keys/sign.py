"""``ropeway keys sign``: certify the key of a machine that made its own."""

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
    open_fleet,
    rights_of,
)
from ropeway.cli.session import JsonOption
from ropeway.errors import IdentityError
from ropeway.networks.overlay.crypto.identity import write_private
from ropeway.networks.overlay.crypto.material import read_material

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def sign(
    request: Annotated[Path, typer.Argument(help="NAME.csr, as keys request makes it.", show_default=False)],
    fleet: FleetOption = None,
    router: RouterOption = False,
    may_publish: MayPublish = None,
    may_subscribe: MaySubscribe = None,
    may_call: MayCall = None,
    may_offer: MayOffer = None,
    days: DaysOption = 365.0,
    connect: ConnectOption = None,
    as_json: JsonOption = False,
) -> None:
    """Sign a request: writes NAME.signed, which is of use only with the key that stayed on its machine."""
    made = open_fleet(fleet)
    path = request.with_suffix(".signed")
    if path.exists():
        raise IdentityError(str(path), "it exists already and is never overwritten; move it away")
    text = made.sign_request(
        read_material(request),
        role="router" if router else "member",
        rights=rights_of(may_publish, may_subscribe, may_call, may_offer),
        days=days,
        routers=connect or (),
    )
    write_private(path, text)
    if as_json:
        print_json({"file": str(path)})
    else:
        answer(f"{path} goes back to its machine. There: ropeway keys join {path.name} {request.stem}.key")
