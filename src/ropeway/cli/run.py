"""``ropeway run``: a gateway, until it is told to stop."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.asking import AsOption
from ropeway.cli.gateway_run import LEAST_PERIOD_S, RunOrder, run_gateway
from ropeway.cli.logs import LEVELS

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("run")
def run_command(
    config: Annotated[Path, typer.Argument(help="A configuration, JSON or YAML.", show_default=False)],
    for_s: Annotated[float, typer.Option("--for", min=0.0, help="End after this many seconds; 0: never.")] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the status as JSON, one line per --period.")] = False,
    period: Annotated[
        float, typer.Option("--period", min=LEAST_PERIOD_S, help="Seconds between two lines of --json.")
    ] = 1.0,
    log_level: Annotated[str, typer.Option("--log-level", help=f"{', '.join(LEVELS)}.")] = "info",
    part: AsOption = "",
    watch: Annotated[bool, typer.Option("--watch", help="Apply CONFIG again whenever it changes.")] = False,
    live: Annotated[
        bool | None,
        typer.Option(
            "--live/--no-live",
            help="Draw the status below the log; default: where stdout is a terminal.",
            show_default=False,
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only warnings and errors.")] = False,
) -> None:
    """Run the gateway that CONFIG describes. Ctrl-C and SIGTERM end it in order, with exit status 0.

    SIGHUP makes it read its certificates and tokens again, and apply CONFIG again if it has changed.
    """
    run_gateway(RunOrder(config, for_s, as_json, period, log_level, part, watch, live, quiet))
