"""``ropeway events``: what happens in a running gateway."""

from __future__ import annotations

import time
from typing import Annotated, Any, Final

import typer

from ropeway.cli.asking import CaOption, CertOption, TokenOption, WhereArgument
from ropeway.cli.console import answer, print_json
from ropeway.cli.session import JsonOption

__all__ = ["app"]

app = typer.Typer(add_completion=False)

_STEPS: Final = 3  # of a change that are shown
_NAMED = ("number", "time", "kind", "name", "state", "before", "why")


@app.command("events")
def events_command(
    where: WhereArgument = "",
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Go on as they happen, until Ctrl-C.")] = False,
    name: Annotated[str, typer.Option("--name", help="Only those of this object.", show_default=False)] = "",
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Show the last changes of state of links, routes and clients, and of the configuration."""
    from ropeway.control.client import ControlClient

    with ControlClient.find(where, token=token, ca=ca, cert=cert) as client:
        last = 0
        for event in client.get("/v1/events", name=name):
            last = event["number"]
            _show(event, as_json=as_json)
        if not follow:
            return
        for event in client.events(after=last):
            if not name or event["name"] == name:
                _show(event, as_json=as_json)


def _show(event: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json(event)
        return
    at = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(event["time"]))
    text = f"{at}  {event['kind']} {event['name']}"
    if "state" in event:
        text += f": {event['before']} -> {event['state']}" if event.get("before") else f": {event['state']}"
    if event.get("why"):
        text += f" ({event['why']})"
    more = " ".join(_said(key, value) for key, value in event.items() if key not in _NAMED)
    answer(f"{text}  {more}".rstrip())


def _said(key: str, value: Any) -> str:
    """Return what an event has beyond its name and state; of the steps of a change the first."""
    if key != "steps" or not isinstance(value, list):
        return f"{key}={value}"
    steps = ", ".join(f"{step.get('action')} {step.get('what')} {step.get('name')}" for step in value[:_STEPS])
    return f"steps: {steps}" + (f" and {len(value) - _STEPS} more" if len(value) > _STEPS else "")
