"""``ropeway store``: the last values of robots and topics."""

from __future__ import annotations

import typer

from ropeway.cli.lazy import lazy_group

__all__ = ["app"]

VERBS = {
    "list": "ropeway.cli.store.list_",
    "get": "ropeway.cli.store.get",
    "watch": "ropeway.cli.store.watch",
    "rm": "ropeway.cli.store.rm",
}

app = typer.Typer(cls=lazy_group(VERBS), name="store", help="Read and remove last values.", add_completion=False)


@app.callback(no_args_is_help=True)
def store() -> None:
    """Read and remove last values."""
