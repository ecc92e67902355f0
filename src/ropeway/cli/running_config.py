"""``ropeway config plan|apply|rollback|history|show|diff``: the configuration of a running gateway."""

from __future__ import annotations

import difflib
import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ropeway.cli.asking import AsOption, CaOption, CertOption, TokenOption, WhereOption
from ropeway.cli.console import answer, complain, print_json
from ropeway.errors import ControlRefused
from ropeway.listener.http import without_token

if TYPE_CHECKING:
    from ropeway.control.client import ControlClient

__all__ = ["add_to", "show_steps"]

FileArgument = Annotated[Path, typer.Argument(help="A configuration, JSON or YAML.", show_default=False)]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
_SIGNS: Mapping[str, str] = {"start": "+", "stop": "-", "change": "~", "replace": "~", "restart": "!", "note": " "}


def add_to(app: typer.Typer) -> None:
    """Add the verbs to those of ``ropeway config``."""
    for verb in (plan, apply, rollback, history, show, diff):
        app.command()(verb)


def plan(
    file: FileArgument,
    where: WhereOption = "",
    part: AsOption = "",
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Show what FILE would start, stop and change in a running gateway, and what that interrupts."""
    with _client(where, token, ca, cert) as client:
        found = client.post("/v1/config/plan", _body(file, part))
    if as_json:
        print_json(found)
    else:
        show_steps(found)


def apply(
    file: FileArgument,
    where: WhereOption = "",
    part: AsOption = "",
    note: Annotated[str, typer.Option("--note", help="A sentence for the history.", show_default=False)] = "",
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Have a running gateway go over to FILE: all of it, or nothing. What stays goes on meanwhile."""
    with _client(where, token, ca, cert) as client:
        known = client.get("/v1/config")["etag"]
        done = _refused_with_steps(
            lambda: client.put("/v1/config", {**_body(file, part), "note": note}, headers={"if-match": f'"{known}"'})
        )
    _say_applied(done, as_json)


def rollback(
    number: Annotated[
        int, typer.Argument(help="An entry of the history; left out: the last other one that ran.", show_default=False)
    ] = 0,
    where: WhereOption = "",
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Have a running gateway go back to a configuration that has run."""
    with _client(where, token, ca, cert) as client:
        done = client.post("/v1/config/rollback", {"number": number} if number else {})
    _say_applied(done, as_json)


def history(
    where: WhereOption = "",
    count: Annotated[int, typer.Option("--count", "-n", min=1, max=1000, help="How many.")] = 20,
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Show who changed a gateway, when, from where, and what."""
    with _client(where, token, ca, cert) as client:
        found = client.get("/v1/config/history", count=count)
    if as_json:
        print_json(found)
        return
    for entry in reversed(found):
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(entry["time"]))
        note = f": {entry['note']}" if entry["note"] else ""
        answer(f"{entry['number']:>5}  {when}  {entry['state']:7} {entry['action']} by {entry['who']}{note}")
        for step in entry["steps"]:
            answer(f"       {_step(step)}")


def show(
    number: Annotated[
        int, typer.Argument(help="An entry of the history; left out: what runs.", show_default=False)
    ] = 0,
    where: WhereOption = "",
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Print the configuration that runs, or one that ran, as JSON in the full form."""
    with _client(where, token, ca, cert) as client:
        answer(json.dumps(_config(client, str(number) if number else ""), indent=2, ensure_ascii=False))


def diff(
    one: Annotated[str, typer.Argument(help="An entry of the history, or a file.", show_default=False)],
    other: Annotated[str, typer.Argument(help="Another; left out: what runs.", show_default=False)] = "",
    where: WhereOption = "",
    part: AsOption = "",
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Compare two configurations in the full form, line by line. The exit status is 1 where they differ."""
    with _client(where, token, ca, cert) as client:
        left, right = (json.dumps(_config(client, name, part), indent=2, ensure_ascii=False) for name in (one, other))
    lines = list(difflib.unified_diff(left.splitlines(), right.splitlines(), one, other or "running", lineterm=""))
    for line in lines:
        answer(without_token(line))
    if lines:
        raise typer.Exit(1)


def show_steps(plan: Mapping[str, Any]) -> None:
    """Print the steps of a plan."""
    for step in plan["steps"]:
        answer(_step(step))
    stays = plan["unchanged_routes"]
    answer(f"{len(plan['steps'])} step(s); {stays} route(s) stay as they are.")


def _say_applied(done: Mapping[str, Any], as_json: bool) -> None:
    if as_json:
        print_json(done)
    elif done["applied"]:
        show_steps(done)
        answer(f"Applied as change {done['number']}." if done["number"] else "Applied; nothing is remembered.")
    else:
        answer("Nothing to do: this is what runs.")


def _step(step: Mapping[str, Any]) -> str:
    details = f" ({'; '.join(step['details'])})" if step["details"] else ""
    interrupts = f"; interrupts {step['interrupts']}" if step["interrupts"] else ""
    return f"{_SIGNS.get(step['action'], ' ')} {step['action']} {step['what']} {step['name']}{details}{interrupts}"


def _refused_with_steps(work: Any) -> Any:
    """Do it; where somebody else was faster, show what was changed meanwhile."""
    try:
        return work()
    except ControlRefused as error:
        for step in error.details.get("meanwhile", ()):
            complain(_step(step))
        raise


def _body(file: Path, part: str) -> dict[str, Any]:
    from ropeway.gateway.config.document import read_file
    from ropeway.gateway.config.fleet import select

    return {"config": select(read_file(file), part), "directory": str(file.resolve().parent)}


def _config(client: ControlClient, name: str, part: str = "") -> Any:
    """Return a configuration in the full form: that of an entry or of a file, or the one that runs."""
    if not name:
        return client.get("/v1/config")["config"]
    if name.isascii() and name.isdigit():
        return client.get(f"/v1/config/history/{name}")["config"]
    from ropeway.gateway.config.fleet import load_one

    return load_one(name, part).to_json()


def _client(where: str, token: str, ca: str, cert: str) -> ControlClient:
    from ropeway.control.client import ControlClient

    return ControlClient.find(where, token=token, ca=ca, cert=cert)
