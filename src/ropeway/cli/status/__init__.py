"""``ropeway status``: how a running gateway is, once or live."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Final, NoReturn

import typer

from ropeway.cli.asking import CaOption, CertOption, TokenOption, WhereArgument
from ropeway.cli.console import print_json

if TYPE_CHECKING:
    from ropeway.control.client import ControlClient

__all__ = ["app"]

app = typer.Typer(add_completion=False)

_PERIOD_S: Final = 1.0


@app.command("status")
def status_command(
    where: WhereArgument = "",
    watch: Annotated[bool, typer.Option("--watch", "-w", "--live", help="Go on until Ctrl-C, once a second.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the status as JSON, one line each time.")] = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Show the links, routes and clients of a running gateway: their states with reasons, rates, delays and drops."""
    from ropeway.control.client import ControlClient

    with ControlClient.find(where, token=token, ca=ca, cert=cert) as client:
        if watch and not as_json:
            _live(client)
        while True:
            _print(client, as_json=as_json)
            if not watch:
                return
            time.sleep(_PERIOD_S)


def _print(client: ControlClient, *, as_json: bool) -> None:
    status = client.get("/v1/status")
    if as_json:
        print_json(status)
        return
    from ropeway.cli.fitting_table import print_table
    from ropeway.cli.status.tables import tables

    for table in tables(status):
        print_table(table)


def _live(client: ControlClient) -> NoReturn:
    from ropeway.cli.live import draw_until_interrupted
    from ropeway.cli.status.tables import tables

    draw_until_interrupted(lambda: tables(client.get("/v1/status")), period_s=_PERIOD_S)
