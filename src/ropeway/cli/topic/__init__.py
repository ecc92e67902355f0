"""``ropeway topic``: look at topics and publish to them, on any graph, as ``ros2 topic`` does."""

from __future__ import annotations

import typer

from ropeway.cli.lazy import lazy_group

__all__ = ["app"]

VERBS = {
    name: f"ropeway.cli.topic.{module}"
    for name, module in {
        "list": "list_",
        "type": "type_",
        "info": "info",
        "find": "find",
        "echo": "echo",
        "hz": "hz",
        "bw": "bw",
        "delay": "delay",
        "pub": "pub",
    }.items()
}

app = typer.Typer(
    cls=lazy_group(VERBS), name="topic", help="Look at topics and publish to them, on any graph.", add_completion=False
)


@app.callback(no_args_is_help=True)
def topic() -> None:
    """Look at topics and publish to them, on any graph."""
