"""``ropeway param``: look at parameters of nodes and set them, on any graph, as ``ros2 param`` does."""

from __future__ import annotations

import typer

from ropeway.cli.lazy import lazy_group

__all__ = ["app"]

VERBS = {
    "list": "ropeway.cli.param.list_",
    "get": "ropeway.cli.param.get",
    "set": "ropeway.cli.param.set_",
    "describe": "ropeway.cli.param.describe",
    "delete": "ropeway.cli.param.delete",
    "dump": "ropeway.cli.param.dump",
    "load": "ropeway.cli.param.load",
}

app = typer.Typer(
    cls=lazy_group(VERBS),
    name="param",
    help="Look at parameters of nodes and set them, on any graph.",
    add_completion=False,
)


@app.callback(no_args_is_help=True)
def param() -> None:
    """Look at parameters of nodes and set them, on any graph."""
