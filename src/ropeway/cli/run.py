"""``ropeway run``: a gateway, until it is told to stop."""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ropeway.cli.asking import AsOption
from ropeway.cli.logs import LEVELS, set_up
from ropeway.cli.loop import run

if TYPE_CHECKING:
    from ropeway.gateway.gateway import Gateway
    from ropeway.gateway.process.supervisor import Supervisor

__all__ = ["app"]

app = typer.Typer(add_completion=False)
log = logging.getLogger("ropeway")


@app.command("run")
def run_command(
    config: Annotated[Path, typer.Argument(help="A configuration, JSON or YAML.", show_default=False)],
    for_s: Annotated[float, typer.Option("--for", min=0.0, help="End after this many seconds; 0: never.")] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the status as JSON, one line per --period.")] = False,
    period: Annotated[float, typer.Option("--period", min=0.05, help="Seconds between two lines of --json.")] = 1.0,
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
    level = set_up("warning" if quiet else log_level)
    from ropeway.cli.serving import Serving, serve
    from ropeway.gateway.config.fleet import load_one

    loaded = load_one(config, part)
    try:
        period_s = period if as_json else None
        drawn = not as_json and (sys.stdout.isatty() and not quiet if live is None else live)
        serving = Serving(loaded, level, for_s or None, period_s, up=_greet, control=True, watch=watch, live=drawn)
        run(serve(serving))
    except KeyboardInterrupt:  # before the handler was there: nothing had been started
        return


def _greet(gateway: Gateway | Supervisor) -> None:
    config = gateway.config
    from ropeway.planning.configured import unfitting

    listen = ", ".join(config.gateway.listen) or 'nowhere ("listen" names no port)'
    remotes = sum(remote.active for remote in config.remotes)
    log.info(
        "%s is on %s, listens at %s, and has %d route(s) to %d remote(s)",
        config.gateway.name,
        ", ".join(config.gateway.graphs),
        listen,
        len(config.routes()),
        remotes,
    )
    for sentence in unfitting(config):
        log.warning("%s", sentence)
