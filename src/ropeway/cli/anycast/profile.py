"""``ropeway anycast profile``: ask each member anew, and use the best."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.anycast.table import GroupOption, show
from ropeway.cli.asking import CaOption, CertOption, TokenOption, WhereArgument

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def profile(
    where: WhereArgument = "",
    group: GroupOption = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print the profile as JSON, on one line.")] = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Ask each member for a moment, with the requests that the robot sends, and use the best."""
    from ropeway.control.client import ControlClient

    with ControlClient.find(where, token=token, ca=ca, cert=cert) as client:
        show([client.post("/v1/anycast/profile", {"group": group})], as_json=as_json)
