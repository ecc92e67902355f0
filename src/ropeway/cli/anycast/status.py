"""``ropeway anycast status``: who is in use, and how late each member is."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Final, NoReturn

import typer

from ropeway.cli.anycast.table import drawn, show
from ropeway.cli.asking import CaOption, CertOption, TokenOption, WhereArgument
from ropeway.cli.console import answer, print_json

if TYPE_CHECKING:
    from ropeway.control.client import ControlClient

__all__ = ["app"]

app = typer.Typer(add_completion=False)

_PERIOD_S: Final = 0.5


@app.command()
def status(
    where: WhereArgument = "",
    watch: Annotated[bool, typer.Option("--watch", "-w", "--live", "-l", help="Go on until Ctrl-C.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print each group as JSON, on one line.")] = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Show the groups of a running gateway."""
    from ropeway.control.client import ControlClient

    with ControlClient.find(where, token=token, ca=ca, cert=cert) as client:
        groups = client.get("/v1/anycast")
        if not groups and not as_json:
            answer("no group: give a remote several addresses (docs/groups.md)")
        elif not watch:
            show(groups, as_json=as_json)
        else:
            _follow(client, as_json)


def _follow(client: ControlClient, as_json: bool) -> NoReturn:
    if not as_json:
        from ropeway.cli.live import draw_until_interrupted

        draw_until_interrupted(lambda: map(drawn, client.get("/v1/anycast")), period_s=_PERIOD_S)
    while True:
        for group in client.get("/v1/anycast"):
            print_json(group)
        time.sleep(_PERIOD_S)
