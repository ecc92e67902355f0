"""``ropeway anycast switch``: use another member, by hand."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.anycast.table import GroupOption, show
from ropeway.cli.asking import CaOption, CertOption, TokenOption, WhereOption

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def switch(
    member: Annotated[str, typer.Argument(help="Its address, or its name in initial_policy.")],
    where: WhereOption = "",
    group: GroupOption = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print the profile as JSON, on one line.")] = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Use a member from the next request on; pause, if the scheduler must not choose another."""
    from ropeway.control.client import ControlClient

    with ControlClient.find(where, token=token, ca=ca, cert=cert) as client:
        show([client.post("/v1/anycast/switch", {"group": group, "member": member})], as_json=as_json)
