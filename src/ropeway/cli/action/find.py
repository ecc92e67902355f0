"""``ropeway action find``: the actions of a type."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.listing import CountOption, find_all, print_list
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, settle_actions
from ropeway.types.definition import canonical_name

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("find")
def find_actions(
    type: Annotated[
        str, typer.Argument(help="The type, such as example_interfaces/action/Fibonacci.", show_default=False)
    ],
    graph: GraphOption = "",
    count: CountOption = False,
    include_hidden: Annotated[
        bool, typer.Option("--include-hidden-actions", help="Show names with a part that starts with _.")
    ] = False,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """List the actions of TYPE."""
    wanted = canonical_name(type, "action")
    found = [info for info in run(find_all(settle_actions, graph, spin_time)) if wanted in info.types]
    print_list(found, show_types=False, count=count, include_hidden=include_hidden, as_json=as_json)
