"""``ropeway service type``: the type of a service."""

from __future__ import annotations

import typer

from ropeway.cli.console import answer, print_json
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
    found = run(find_service(graph, full_name(service), spin_time))
    if as_json:
        print_json({"name": found.name, "types": found.types})
    else:
        answer("\n".join(found.types))
