"""``ropeway lifecycle nodes``: the managed nodes there are."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.lifecycle.common import managed
from ropeway.cli.listing import CountOption
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, open_session, settle_services
from ropeway.cli.topic.list_ import hidden

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("nodes")
def nodes(
    graph: GraphOption = "",
    count: CountOption = False,
    include_hidden: Annotated[
        bool, typer.Option("--all", "-a", help="Show names with a part that starts with _.")
    ] = False,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """List the managed nodes: those with a state that can be asked for."""

    async def look() -> list[str]:
        async with open_session(graph) as session:
            return managed(await settle_services(session.graph, spin_time))

    found = [name for name in run(look()) if include_hidden or not hidden(name)]
    if as_json:
        print_json(found)
    elif count:
        answer(str(len(found)))
    else:
        for name in found:
            answer(name)
