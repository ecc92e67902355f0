"""``ropeway service info``: how many serve and call a service."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.listing import count_of_others, find_one, info_json
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, full_name, settle_services
from ropeway.graph.calls import ServiceInfo

__all__ = ["ServiceArgument", "app", "find_service", "info_text"]

app = typer.Typer(add_completion=False)

ServiceArgument = Annotated[str, typer.Argument(help="The service, such as /add_two_ints.", show_default=False)]


async def find_service(graph: str, name: str, spin_time_s: float, *, whole: bool = False) -> ServiceInfo:
    """Return the service on the graph at the URL ``graph``, or exit with a sentence; ``whole`` waits for all its
    endpoints.
    """
    return await find_one(settle_services, "service", graph, name, spin_time_s, whole=whole)


def info_text(info: ServiceInfo, *, verbose: bool = False) -> str:
    """Return the lines of ``ros2 service info``; ``verbose`` names its servers and clients."""
    lines = [f"Type: {info.types[0] if len(info.types) == 1 else list(info.types)}"]
    for noun, ends in (("Clients", info.clients), ("Services", info.servers)):
        lines.append(f"{noun} count: {count_of_others(ends)}")
        if verbose:
            lines.extend(f"    {end}" for end in ends if not end.local)
    return "\n".join(lines)


@app.command("info")
def info(
    service: ServiceArgument,
    graph: GraphOption = "",
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="List its servers and clients.")] = False,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Show the type of SERVICE and count who serves and calls it."""
    found = run(find_service(graph, full_name(service), spin_time, whole=True))
    if as_json:
        print_json(info_json(found))
    else:
        answer(info_text(found, verbose=verbose))
