"""``ropeway service type``: the type of a service."""

from __future__ import annotations

import typer

from ropeway.cli.listing import print_types
from ropeway.cli.loop import run
from ropeway.cli.service.info import ServiceArgument, find_service
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, full_name

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("type")
def type_of_service(
    service: ServiceArgument, graph: GraphOption = "", spin_time: SpinOption = 2.0, as_json: JsonOption = False
) -> None:
    """Show the type of SERVICE."""
    print_types(run(find_service(graph, full_name(service), spin_time)), as_json=as_json)
