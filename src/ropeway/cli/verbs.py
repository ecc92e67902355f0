"""Has every verb of the command ``ropeway`` in a module of its own, which is imported when it is used."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from ropeway import __version__
from ropeway.cli.console import reported
from ropeway.cli.lazy import lazy_group

__all__ = ["VERBS", "app"]

VERBS = {
    "run": "ropeway.cli.run",
    "status": "ropeway.cli.status",
    "events": "ropeway.cli.events",
    "audit": "ropeway.cli.audit",
    "session": "ropeway.cli.client_sessions",
    "dashboard": "ropeway.cli.dashboard",
    "server": "ropeway.cli.server",
    "config": "ropeway.cli.config",
    "route": "ropeway.cli.route",
    "topic": "ropeway.cli.topic",
    "service": "ropeway.cli.service",
    "action": "ropeway.cli.action",
    "node": "ropeway.cli.node",
    "param": "ropeway.cli.param",
    "lifecycle": "ropeway.cli.lifecycle",
    "interface": "ropeway.cli.interface",
    "store": "ropeway.cli.store",
    "keys": "ropeway.cli.keys",
    "name": "ropeway.cli.name",
    "overlay": "ropeway.cli.overlay",
    "router": "ropeway.cli.router",
    "explain": "ropeway.cli.explain",
    "doctor": "ropeway.cli.doctor",
    "anycast": "ropeway.cli.anycast",
    "predict": "ropeway.cli.predict",
    "play": "ropeway.cli.play",
    "record": "ropeway.cli.record",
    "bag": "ropeway.cli.bag",
    "demo": "ropeway.cli.demo",
    "demo-iort": "ropeway.cli.demo_iort",
    "demo-anycast": "ropeway.cli.demo_anycast",
    "demo-robots": "ropeway.cli.demo_robots",
}


class _Ropeway(lazy_group(VERBS)):  # type: ignore[misc]
    """The top of the command line, where errors become sentences."""

    def invoke(self, ctx: Any) -> Any:
        with reported():
            return super().invoke(ctx)


app = typer.Typer(
    cls=_Ropeway,
    name="ropeway",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"ropeway {__version__}")
        raise typer.Exit


@app.callback()
def ropeway(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Join robots and clouds that live on different networks."""
