"""``ropeway node``: look at nodes, on any graph, as ``ros2 node`` does."""

from __future__ import annotations

import typer

from ropeway.cli.lazy import lazy_group

__all__ = ["app"]

VERBS = {
    "list": "ropeway.cli.node.list_",
    "info": "ropeway.cli.node.info",
}

app = typer.Typer(cls=lazy_group(VERBS), name="node", help="Look at nodes, on any graph.", add_completion=False)


@app.callback(no_args_is_help=True)
def node() -> None:
    """Look at nodes, on any graph."""
