"""``ropeway keys``: who belongs to a fleet, and what each member may do."""

from __future__ import annotations

import typer

from ropeway.cli.lazy import lazy_group

__all__ = ["app"]

VERBS = {
    "init": "ropeway.cli.keys.init",
    "issue": "ropeway.cli.keys.issue",
    "request": "ropeway.cli.keys.request",
    "sign": "ropeway.cli.keys.sign",
    "join": "ropeway.cli.keys.join",
    "show": "ropeway.cli.keys.show",
    "revoke": "ropeway.cli.keys.revoke",
    "renew": "ropeway.cli.keys.renew",
}

app = typer.Typer(cls=lazy_group(VERBS), name="keys", help="Make a fleet and its members.", add_completion=False)


@app.callback(no_args_is_help=True)
def keys() -> None:
    """Make a fleet and its members."""
