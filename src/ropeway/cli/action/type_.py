"""``ropeway action type``: the type of an action."""

from __future__ import annotations

import typer

from ropeway.cli.action.info import ActionArgument, find_action
from ropeway.cli.listing import print_types
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, full_name

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("type")
def type_of_action(
    action: ActionArgument, graph: GraphOption = "", spin_time: SpinOption = 2.0, as_json: JsonOption = False
) -> None:
    """Show the type of ACTION."""
    print_types(run(find_action(graph, full_name(action), spin_time)), as_json=as_json)
