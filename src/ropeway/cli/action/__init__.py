"""``ropeway action``: look at actions and send goals, on any graph, as ``ros2 action`` does."""

from __future__ import annotations

import typer

from ropeway.cli.lazy import lazy_group

__all__ = ["app"]

VERBS = {
    "list": "ropeway.cli.action.list_",
    "type": "ropeway.cli.action.type_",
    "info": "ropeway.cli.action.info",
    "find": "ropeway.cli.action.find",
    "send_goal": "ropeway.cli.action.send_goal",
}

app = typer.Typer(
    cls=lazy_group(VERBS), name="action", help="Look at actions and send goals, on any graph.", add_completion=False
)


@app.callback(no_args_is_help=True)
def action() -> None:
    """Look at actions and send goals, on any graph."""
