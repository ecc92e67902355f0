"""``ropeway param set``: set a parameter."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.param.common import NameArgument, NodeArgument, TimeoutOption, ask, plain
from ropeway.cli.param.source import parameters_of, place_name
from ropeway.cli.session import GraphOption, JsonOption, OpenGraph
from ropeway.graph.parameters import parse_value, type_of

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("set")
def set_command(
    node: NodeArgument,
    name: NameArgument,
    value: Annotated[str, typer.Argument(help="The value in YAML, such as 1.5 or '[1, 2]'.", show_default=False)],
    graph: GraphOption = "",
    timeout: TimeoutOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Set the parameter NAME of NODE. The type follows from VALUE: 1 is an integer, 1.0 a double, "'1'" a text."""
    full = place_name(node)
    parsed = parse_value(value)

    async def work(session: OpenGraph) -> str | None:
        return (await parameters_of(session, full, timeout).set({name: parsed}))[name]

    refused = ask(graph, full, timeout, work)
    if as_json:
        print_json(
            {"node": full, "name": name, "value": plain(parsed), "set": refused is None, "reason": refused or ""}
        )
    if refused is not None:
        fail(
            f"setting {name} of {full} to {plain(parsed)!r} ({type_of(parsed).label}) failed: {refused or 'no reason'}"
        )
    if not as_json:
        answer("Set parameter successful")
