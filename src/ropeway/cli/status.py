"""``ropeway status``: how a running gateway is."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.asking import CaOption, TokenOption, WhereArgument
from ropeway.cli.console import answer, print_json

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("status")
def status_command(
    where: WhereArgument = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print the status as JSON, on one line.")] = False,
    token: TokenOption = "",
    ca: CaOption = "",
) -> None:
    """Show the links and routes of a running gateway."""
    from ropeway.control.client import ControlClient

    with ControlClient.find(where, token=token, ca=ca) as client:
        status = client.get("/v1/status")
    if as_json:
        print_json(status)
        return
    answer(f"{status['name']}: {len(status['remotes'])} remote(s), {len(status['routes'])} route(s)")
    for remote in status["remotes"]:
        error = f" ({remote['error']})" if remote.get("error") else ""
        answer(f"  {remote['address']}: {remote['state']}{error}")
    for route in status["routes"]:
        error = f" ({route['error']})" if route.get("error") else ""
        answer(f"  {route['operation']} {route['name']} [{route['type']}]: {route['state']}{error}")
