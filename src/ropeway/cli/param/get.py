"""``ropeway param get``: the value of a parameter."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.param.common import NameArgument, NodeArgument, TimeoutOption, ask, plain, value_text
from ropeway.cli.param.source import label_of, parameters_of, place_name
from ropeway.cli.session import GraphOption, JsonOption, OpenGraph

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("get")
def get(
    node: NodeArgument,
    name: NameArgument,
    graph: GraphOption = "",
    hide_type: Annotated[bool, typer.Option("--hide-type", help="Print the value alone.")] = False,
    timeout: TimeoutOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Show the value of the parameter NAME of NODE."""
    full = place_name(node)

    async def look(session: OpenGraph) -> Any:
        return (await parameters_of(session, full, timeout).get([name]))[name]

    value = ask(graph, full, timeout, look)
    if as_json:
        print_json({"node": full, "name": name, "type": label_of(value), "value": plain(value)})
    elif value is not None:
        answer(value_text(value, hide_type=hide_type))
    if value is None:
        fail(f"parameter {name} of {full} is not set; see `ropeway param list {full}`")
