"""``ropeway service find``: the services of a type."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.listing import CountOption, find_all, print_list
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, settle_services
from ropeway.types.definition import canonical_name

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("find")
def find_services(
    type: Annotated[str, typer.Argument(help="The type, such as std_srvs/srv/Trigger.", show_default=False)],
    graph: GraphOption = "",
    count: CountOption = False,
    include_hidden: Annotated[
        bool, typer.Option("--include-hidden-services", help="Show names with a part that starts with _.")
    ] = False,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """List the services of TYPE."""
    wanted = canonical_name(type, "srv")
    found = [info for info in run(find_all(settle_services, graph, spin_time)) if wanted in info.types]
    print_list(found, show_types=False, count=count, include_hidden=include_hidden, as_json=as_json)
