"""``ropeway session``: the clients of a running gateway."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import quote

import typer

from ropeway.cli.asking import CaOption, CertOption, TokenOption, WhereArgument, WhereOption
from ropeway.cli.console import answer, print_json
from ropeway.cli.session import JsonOption

__all__ = ["app"]

app = typer.Typer(name="session", help="See and disconnect clients.", no_args_is_help=True, add_completion=False)


@app.command("list")
def list_command(
    where: WhereArgument = "",
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """List the clients and gateways that are connected to a running gateway."""
    from ropeway.cli.fitting_table import print_table
    from ropeway.cli.status.tables import session_table
    from ropeway.control.client import ControlClient

    with ControlClient.find(where, token=token, ca=ca, cert=cert) as client:
        sessions = client.get("/v1/sessions")
    if as_json:
        print_json(sessions)
    elif sessions:
        print_table(session_table(sessions))
    else:
        answer("nobody is connected")


@app.command("kick")
def kick_command(
    peer: Annotated[str, typer.Argument(help="Its address and port, as session list shows it.", show_default=False)],
    where: WhereOption = "",
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Disconnect a client; it may come back."""
    from ropeway.control.client import ControlClient

    with ControlClient.find(where, token=token, ca=ca, cert=cert) as client:
        done = client.delete(f"/v1/sessions/{quote(peer, safe='')}")
    if as_json:
        print_json(done)
    else:
        answer(f"{peer} was disconnected")
