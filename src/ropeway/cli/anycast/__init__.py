"""``ropeway anycast``: groups of a running gateway, and what may be done to them by hand."""

from __future__ import annotations

import typer

from ropeway.cli.lazy import lazy_group

__all__ = ["app"]

VERBS = {
    "status": "ropeway.cli.anycast.status",
    "profile": "ropeway.cli.anycast.profile",
    "switch": "ropeway.cli.anycast.switch",
    "pause": "ropeway.cli.anycast.pause",
}

app = typer.Typer(cls=lazy_group(VERBS), name="anycast", help="Look after groups.", add_completion=False)


@app.callback(no_args_is_help=True)
def anycast() -> None:
    """Look at the groups of a running gateway, and choose by hand."""
