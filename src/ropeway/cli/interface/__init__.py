"""``ropeway interface``: look at definitions of messages, services and actions, as ``ros2 interface`` does."""

from __future__ import annotations

import typer

from ropeway.cli.lazy import lazy_group

__all__ = ["app"]

VERBS = {
    "show": "ropeway.cli.interface.show",
    "list": "ropeway.cli.interface.list_",
    "package": "ropeway.cli.interface.package",
    "packages": "ropeway.cli.interface.packages",
    "proto": "ropeway.cli.interface.proto",
}

app = typer.Typer(
    cls=lazy_group(VERBS),
    name="interface",
    help="Look at definitions of messages, services and actions.",
    add_completion=False,
)


@app.callback(no_args_is_help=True)
def interface() -> None:
    """Look at definitions of messages, services and actions."""
