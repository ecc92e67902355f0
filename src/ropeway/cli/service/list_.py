"""``ropeway service list``: the services there are."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.listing import CountOption, ShowTypesOption, print_list
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, open_session, settle_services
from ropeway.graph.calls import ServiceInfo

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("list")
def list_services(
    graph: GraphOption = "",
    show_types: ShowTypesOption = False,
    count: CountOption = False,
    include_hidden: Annotated[
        bool, typer.Option("--include-hidden-services", help="Show names with a part that starts with _.")
    ] = False,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """List the services."""

    async def look() -> dict[str, ServiceInfo]:
        async with open_session(graph) as session:
            return await settle_services(session.graph, spin_time)

    infos = run(look()).values()
    print_list(infos, show_types=show_types, count=count, include_hidden=include_hidden, as_json=as_json)
