"""``ropeway param describe``: what a node says of its parameters."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, complain, print_json
from ropeway.cli.param.common import NodeArgument, TimeoutOption, ask
from ropeway.cli.param.source import parameters_of, place_name
from ropeway.cli.session import GraphOption, JsonOption, OpenGraph
from ropeway.graph.parameters import ParameterDescription

__all__ = ["app", "description_text"]

app = typer.Typer(add_completion=False)


def description_text(found: ParameterDescription) -> str:
    """Return the lines of ``ros2 param describe``."""
    lines = [f"Parameter name: {found.name}", f"  Type: {found.type.label}"]
    if found.description:
        lines.append(f"  Description: {found.description}")
    lines.append("  Constraints:")
    if found.read_only:
        lines.append("    Read only: true")
    if found.range is not None:
        lowest, highest, step = found.range
        lines.extend([f"    Min value: {lowest}", f"    Max value: {highest}"])
        if step:
            lines.append(f"    Step: {step}")
    if found.constraints:
        lines.append(f"    Additional constraints: {found.constraints}")
    return "\n".join(lines)


@app.command("describe")
def describe(
    node: NodeArgument,
    names: Annotated[list[str], typer.Argument(help="The parameters, such as use_sim_time.", show_default=False)],
    graph: GraphOption = "",
    timeout: TimeoutOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Show type, meaning and limits of the parameters NAMES of NODE."""
    full = place_name(node)

    async def look(session: OpenGraph) -> dict[str, ParameterDescription | None]:
        return await parameters_of(session, full, timeout).describe(names)

    found = ask(graph, full, timeout, look)
    for one in found.values():
        if one is None:
            continue
        if as_json:
            print_json(
                {
                    "name": one.name,
                    "type": one.type.label,
                    "description": one.description,
                    "constraints": one.constraints,
                    "read_only": one.read_only,
                    "dynamic_typing": one.dynamic_typing,
                    "range": one.range,
                }
            )
        else:
            answer(description_text(one))
    absent = [name for name, one in found.items() if one is None]
    for name in absent:
        complain(f"ropeway: node {full} has no parameter {name}; see `ropeway param list {full}`")
    if absent:
        raise typer.Exit(1)
