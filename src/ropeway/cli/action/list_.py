"""``ropeway action list``: the actions there are."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.listing import CountOption, ShowTypesOption, find_all, print_list
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, settle_actions

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("list")
def list_actions(
    graph: GraphOption = "",
    show_types: ShowTypesOption = False,
    count: CountOption = False,
    include_hidden: Annotated[
        bool, typer.Option("--include-hidden-actions", help="Show names with a part that starts with _.")
    ] = False,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """List the actions."""
    infos = run(find_all(settle_actions, graph, spin_time))
    print_list(infos, show_types=show_types, count=count, include_hidden=include_hidden, as_json=as_json)
