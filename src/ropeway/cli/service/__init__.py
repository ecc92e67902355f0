"""``ropeway service``: look at services and call them, on any graph, as ``ros2 service`` does."""

from __future__ import annotations

import typer

from ropeway.cli.lazy import lazy_group

__all__ = ["app"]

VERBS = {
    "list": "ropeway.cli.service.list_",
    "type": "ropeway.cli.service.type_",
    "info": "ropeway.cli.service.info",
    "find": "ropeway.cli.service.find",
    "call": "ropeway.cli.service.call",
    "echo": "ropeway.cli.service.echo",
}

app = typer.Typer(
    cls=lazy_group(VERBS), name="service", help="Look at services and call them, on any graph.", add_completion=False
)


@app.callback(no_args_is_help=True)
def service() -> None:
    """Look at services and call them, on any graph."""
