"""``ropeway keys init``: a new fleet."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.keys.common import ConnectOption
from ropeway.cli.session import JsonOption
from ropeway.networks.overlay.fleet import ALGORITHMS, Fleet

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def init(
    fleet: Annotated[str, typer.Argument(help="Its name.", show_default=False)],
    directory: Annotated[
        Path | None,
        typer.Option("--directory", help="The directory; by default, one of that name.", show_default=False),
    ] = None,
    algorithm: Annotated[
        str, typer.Option("--algorithm", help=f"The algorithm of all keys: {' or '.join(ALGORITHMS)}.")
    ] = "ed25519",
    connect: ConnectOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a fleet: its authority and its name secret, in a directory that stays with you and never goes on a robot."""
    made = Fleet.create(fleet, directory or Path(fleet), algorithm=algorithm, routers=connect or ())
    if as_json:
        print_json({"fleet": made.name, "directory": str(made.directory), "algorithm": made.algorithm})
    else:
        answer(f"{made.directory}: fleet {made.name}. Keep ca.key and name.secret to yourself.")
        answer(f"Next: ropeway keys issue robot1 --fleet {made.directory}")
