"""``ropeway bag``: record, play and look at recordings, as ``ros2 bag`` does."""

from __future__ import annotations

import typer

from ropeway.cli.lazy import lazy_group

__all__ = ["app"]

VERBS = {
    "info": "ropeway.cli.bag.info",
    "record": "ropeway.cli.record",
    "play": "ropeway.cli.play",
}

app = typer.Typer(cls=lazy_group(VERBS), name="bag", help="Record, play and look at recordings.", add_completion=False)


@app.callback(no_args_is_help=True)
def bag() -> None:
    """Record, play and look at recordings."""
