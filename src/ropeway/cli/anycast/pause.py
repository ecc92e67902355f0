"""``ropeway anycast pause``: keep the member in use."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.anycast.table import GroupOption, show
from ropeway.cli.asking import CaOption, CertOption, TokenOption, WhereArgument

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def pause(
    where: WhereArgument = "",
    off: Annotated[bool, typer.Option("--off", help="Choose again.")] = False,
    group: GroupOption = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print the profile as JSON, on one line.")] = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Change nothing until the member in use is gone."""
    from ropeway.control.client import ControlClient

    with ControlClient.find(where, token=token, ca=ca, cert=cert) as client:
        show([client.post("/v1/anycast/pause", {"group": group, "paused": not off})], as_json=as_json)
