"""``ropeway node list``: the nodes there are."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.listing import CountOption
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, open_session, settle_nodes
from ropeway.cli.topic.list_ import hidden
from ropeway.graph.base import NodeInfo

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("list")
def list_nodes(
    graph: GraphOption = "",
    show_all: Annotated[bool, typer.Option("--all", "-a", help="Show names with a part that starts with _.")] = False,
    count: CountOption = False,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """List the nodes."""

    async def look() -> dict[str, NodeInfo]:
        async with open_session(graph) as session:
            return await settle_nodes(session.graph, spin_time)

    names = [name for name in sorted(run(look())) if show_all or not hidden(name)]
    if as_json:
        print_json([{"name": name} for name in names])
    elif count:
        answer(str(len(names)))
    else:
        for name in names:
            answer(name)
