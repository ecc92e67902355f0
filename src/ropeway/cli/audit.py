"""``ropeway audit``: who changed a running gateway, commanded, was denied, refused or disconnected."""

from __future__ import annotations

import time
from datetime import datetime, timezone
from typing import Annotated, Any, Final

import typer

from ropeway.cli.asking import CaOption, CertOption, TokenOption, WhereArgument
from ropeway.cli.console import answer, complain, fail, print_json
from ropeway.cli.session import JsonOption

__all__ = ["app"]

app = typer.Typer(add_completion=False)

_NAMED: Final = ("number", "time", "kind", "who", "where", "operation", "name", "outcome", "why", "since", "details")


@app.command("audit")
def audit_command(
    where: WhereArgument = "",
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Go on as entries come, until Ctrl-C.")] = False,
    count: Annotated[int, typer.Option("--count", "-n", min=0, help="How many of the newest entries.")] = 100,
    kind: Annotated[
        str,
        typer.Option("--kind", help="Only change, operate, command, denied, refused, kicked, audit; several with ,"),
    ] = "",
    who: Annotated[str, typer.Option("--who", help="Only of this user or role; a part will do.")] = "",
    peer: Annotated[str, typer.Option("--from", help="Only from this address; a part will do.")] = "",
    name: Annotated[str, typer.Option("--name", help="Only about this topic, service, route …; a part will do.")] = "",
    since: Annotated[
        str, typer.Option("--since", help="Only from then on: 2026-01-31T14:00, or 90s, 15m, 12h, 7d ago.")
    ] = "",
    until: Annotated[str, typer.Option("--until", help="Only up to then, likewise.")] = "",
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Show the audit log of a running gateway, the newest entries last."""
    from ropeway.control.client import ControlClient

    chosen: dict[str, Any] = {"kind": kind, "who": who, "where": peer, "name": name}
    if since:
        chosen["since"] = _moment(since, "--since")
    if until:
        chosen["until"] = _moment(until, "--until")
    with ControlClient.find(where, token=token, ca=ca, cert=cert) as client:
        found = client.get("/v1/audit", count=count, **chosen)
        for entry in found["entries"]:
            _show(entry, as_json=as_json)
        if found["lost"]:
            complain(f"{found['lost']} notes did not fit since the gateway has started; entries of kind audit say when")
        if found["error"]:
            complain(f"the log cannot be written ({found['error']}): {found['unwritten']} entries are only in memory")
        if follow:
            last = found["entries"][-1]["number"] if found["entries"] else 0
            for entry in client.stream("/v1/audit/stream", **chosen, **({"after": last} if last else {})):
                _show(entry, as_json=as_json)


def _show(entry: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json(entry)
        return
    at = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(entry["time"]))
    by = f" by {entry['who']}" if entry["who"] else ""
    origin = f" from {entry['where']}" if entry["where"] else ""
    about = " ".join(filter(None, (entry["operation"], entry["name"])))
    ended = "" if entry["outcome"] == "done" else f": {entry['outcome']}"
    why = f" ({entry['why']})" if entry.get("why") else ""
    rest = {**{key: value for key, value in entry.items() if key not in _NAMED}, **entry.get("details", {})}
    more = " ".join(f"{key}={_plain(value)}" for key, value in rest.items())
    answer(f"{at}  {entry['kind']:<8}{about}{by}{origin}{ended}{why}  {more}".rstrip())


def _plain(value: Any) -> str:
    return f"{len(value)} entries" if isinstance(value, list) else str(value)


def _moment(text: str, option: str) -> str:
    """Return a time as seconds since 1970."""
    number, unit = text[:-1], {"s": 1, "m": 60, "h": 3600, "d": 86_400}.get(text[-1:])
    if unit is not None and number.isascii() and number.isdigit():
        return f"{max(time.time() - int(number) * unit, 0):.3f}"
    try:
        at = datetime.fromisoformat(text)
    except ValueError:
        fail(f"{option}: expected a time such as 2026-01-31T14:00, or 15m for 15 minutes ago, got {text}", 2)
    at = at if at.tzinfo is not None else at.replace(tzinfo=datetime.now().astimezone().tzinfo)
    return f"{max(at.astimezone(timezone.utc).timestamp(), 0):.3f}"
