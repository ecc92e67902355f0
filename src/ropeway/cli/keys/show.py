"""``ropeway keys show``: what a bundle, or a fleet, holds. Never a secret."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.keys.common import about, describe
from ropeway.cli.session import JsonOption
from ropeway.errors import SealError
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.fleet import Fleet

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def show(
    file: Annotated[Path, typer.Argument(help="A bundle, or the directory of a fleet.", show_default=False)],
    as_json: JsonOption = False,
) -> None:
    """Say whose bundle it is, what it allows and until when; or what a fleet has issued."""
    if file.is_dir():
        _show_fleet(Fleet(file), as_json)
        return
    identity = Identity.load(file)
    trust = Trust(identity.ca, identity.crl)
    problem = ""
    try:
        trust.check(identity.certificate.der, role=identity.certificate.role)
    except SealError as error:
        problem = str(error)
    if as_json:
        print_json(
            {
                "fleet": identity.fleet,
                "routers": list(identity.routers),
                "problem": problem,
                **about(identity.certificate),
            }
        )
        return
    answer(f"fleet         {identity.fleet}")
    answer(describe(identity.certificate))
    routers = ", ".join(identity.routers) or "none; members link directly, or the configuration names them"
    answer(f"routers       {routers}")
    if problem:
        answer(f"It is of no use: {problem}")


def _show_fleet(fleet: Fleet, as_json: bool) -> None:
    if as_json:
        rows = [{**row, "serial": f"{row['serial']:x}"} for row in fleet.issued()]
        print_json({"fleet": fleet.name, "algorithm": fleet.algorithm, "issued": rows})
        return
    for row in fleet.issued():
        state = "revoked" if row.get("revoked") else f"until {row['not_after'][:10]}"
        answer(f"{row['name']:<24}{row['role']:<8}{state}")
