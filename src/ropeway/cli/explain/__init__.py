"""``ropeway explain``: why does it not cross?"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated, Any

import typer

from ropeway.cli.asking import AsOption, CaOption, CertOption, TokenOption, WhereOption
from ropeway.cli.console import print_json
from ropeway.cli.session import JsonOption, full_name

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("explain")
def explain_command(
    name: Annotated[str, typer.Argument(help="A topic, service or action, such as /odom.", show_default=False)],
    config: Annotated[
        Path | None,
        typer.Argument(
            help="A gateway's configuration, JSON or YAML: its route is tried. Without it, a running gateway is asked.",
            show_default=False,
        ),
    ] = None,
    to: Annotated[
        str, typer.Option("--to", help="Only this remote: a part of its address, title or name.", show_default=False)
    ] = "",
    part: AsOption = "",
    where: WhereOption = "",
    spin_time: Annotated[
        float, typer.Option("--spin-time", min=0.5, help="Seconds to try at most, for discovery and the link.")
    ] = 3.0,
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Say why NAME crosses or does not: each step from who publishes it to who reads it, on both ends.

    The exit status is 0 if it crosses and 1 if it does not.
    """
    from ropeway.cli.explain.words import lines

    topic = full_name(name)
    found = (
        _tried(config, part, topic, to, spin_time) if config is not None else _asked(where, topic, to, token, ca, cert)
    )
    if as_json:
        print_json(found)
    else:
        for line in lines(found):
            typer.echo(line)
    if not all(explanation["crosses"] for explanation in found):
        raise typer.Exit(1)


def _tried(config: Path, part: str, name: str, to: str, spin_time_s: float) -> list[dict[str, Any]]:
    from ropeway.cli.explain.trial import try_out
    from ropeway.cli.loop import run

    log = logging.getLogger("ropeway")
    level = log.level
    log.setLevel(logging.ERROR)  # what goes wrong is what is explained
    try:
        return [explanation.to_json() for explanation in run(try_out(config, name, to, spin_time_s, part))]
    finally:
        log.setLevel(level)


def _asked(where: str, name: str, to: str, token: str, ca: str, cert: str) -> list[dict[str, Any]]:
    from ropeway.control.client import ControlClient

    with ControlClient.find(where, token=token, ca=ca, cert=cert) as client:
        found: list[dict[str, Any]] = client.get("/v1/explain", name=name, to=to)
    return found
