"""``ropeway action info``: who serves and uses an action."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.listing import CountOption, ShowTypesOption, count_of_others, find_one, info_json
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, full_name, settle_actions
from ropeway.graph.calls import ActionInfo

__all__ = ["ActionArgument", "app", "find_action", "info_text"]

app = typer.Typer(add_completion=False)

ActionArgument = Annotated[str, typer.Argument(help="The action, such as /fibonacci.", show_default=False)]


async def find_action(graph: str, name: str, spin_time_s: float, *, whole: bool = False) -> ActionInfo:
    """Return the action on the graph at the URL ``graph``, or exit with a sentence; ``whole`` waits for all its
    endpoints.
    """
    return await find_one(settle_actions, "action", graph, name, spin_time_s, whole=whole)


def info_text(info: ActionInfo, *, show_types: bool = False, count: bool = False) -> str:
    """Return the lines of ``ros2 action info``; ``count`` leaves the names out."""
    lines = [f"Action: {info.name}"]
    types = f" [{', '.join(info.types)}]" if show_types else ""
    for noun, ends in (("clients", info.clients), ("servers", info.servers)):
        lines.append(f"Action {noun}: {count_of_others(ends)}")
        if not count:
            lines.extend(f"    {end.node or end}{types}" for end in ends if not end.local)
    return "\n".join(lines)


@app.command("info")
def info(
    action: ActionArgument,
    graph: GraphOption = "",
    show_types: ShowTypesOption = False,
    count: CountOption = False,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Show who serves and who uses ACTION."""
    found = run(find_action(graph, full_name(action), spin_time, whole=True))
    if as_json:
        print_json(info_json(found))
    else:
        answer(info_text(found, show_types=show_types, count=count))
