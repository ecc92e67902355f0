"""``ropeway overlay``: look at the overlay as a member sees it."""

from __future__ import annotations

import typer

from ropeway.cli.lazy import lazy_group

__all__ = ["app"]

VERBS = {
    "status": "ropeway.cli.overlay.status",
    "list": "ropeway.cli.overlay.list_",
    "trace": "ropeway.cli.overlay.trace",
    "capture": "ropeway.cli.overlay.capture",
    "verify": "ropeway.cli.overlay.verify",
}

app = typer.Typer(cls=lazy_group(VERBS), name="overlay", help="Look at the overlay.", add_completion=False)


@app.callback(no_args_is_help=True)
def overlay() -> None:
    """Look at the overlay."""
