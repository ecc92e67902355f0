"""``ropeway lifecycle``: look at the states of managed nodes and change them, as ``ros2 lifecycle`` does."""

from __future__ import annotations

import typer

from ropeway.cli.lazy import lazy_group

__all__ = ["app"]

VERBS = {
    "nodes": "ropeway.cli.lifecycle.nodes",
    "get": "ropeway.cli.lifecycle.get",
    "list": "ropeway.cli.lifecycle.list_",
    "set": "ropeway.cli.lifecycle.set_",
}

app = typer.Typer(
    cls=lazy_group(VERBS),
    name="lifecycle",
    help="Look at the states of managed nodes and change them, on any graph.",
    add_completion=False,
)


@app.callback(no_args_is_help=True)
def lifecycle() -> None:
    """Look at the states of managed nodes and change them, on any graph."""
