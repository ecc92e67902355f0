"""``ropeway service echo``: the calls of a service, as its clients and servers tell of them (service introspection)."""

from __future__ import annotations

from typing import Annotated, Final

import typer

from ropeway import aio
from ropeway.cli.console import fail
from ropeway.cli.loop import run
from ropeway.cli.service.info import ServiceArgument
from ropeway.cli.session import (
    GraphOption,
    JsonOption,
    OpenGraph,
    SpinOption,
    TypesOption,
    full_name,
    open_session,
    settle_services,
)
from ropeway.cli.topic.echo import echo, formatter
from ropeway.cli.topic.render import Style
from ropeway.types.definition import canonical_name

__all__ = ["EVENTS", "app"]

app = typer.Typer(add_completion=False)

EVENTS: Final = "/_service_event"
"""Names the topic of a service's events, after the name of the service."""


@app.command("echo")
def echo_command(
    service: ServiceArgument,
    type: Annotated[str, typer.Argument(help="Its type, if it is not discovered.", show_default=False)] = "",
    graph: GraphOption = "",
    once: Annotated[bool, typer.Option("--once", help="Print the first event and end.")] = False,
    timeout: Annotated[float, typer.Option("--timeout", min=0.0, help="End after this many seconds; 0: never.")] = 0.0,
    csv: Annotated[bool, typer.Option("--csv", help="All values on one line, separated by commas.")] = False,
    full_length: Annotated[bool, typer.Option("--full-length", "-f", help="Do not cut arrays and strings.")] = False,
    truncate_length: Annotated[
        int, typer.Option("--truncate-length", "-l", min=0, help="The length at which arrays and strings are cut.")
    ] = 128,
    no_arr: Annotated[bool, typer.Option("--no-arr", help="Only say how long arrays are.")] = False,
    no_str: Annotated[bool, typer.Option("--no-str", help="Only say how long strings are.")] = False,
    flow_style: Annotated[bool, typer.Option("--flow-style", help="YAML on one line.")] = False,
    types: TypesOption = None,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Print requests and responses of SERVICE, where its nodes have introspection switched on."""
    name = full_name(service)
    if csv and as_json:
        fail("--csv and --json exclude each other; give one", 2)
    style = Style(None if full_length else truncate_length, no_arr, no_str, flow_style)

    async def main() -> int:
        async with open_session(graph, types) as session:
            full = canonical_name(type, "srv") if type else await _discovered(session, name, spin_time)
            await session.know(full)
            events = f"{full}_Event"
            form = formatter(
                session.registry, events, style=style, form="json" if as_json else "csv" if csv else "yaml"
            )
            try:
                async with aio.timeout(timeout or None):
                    return await echo(session, name + EVENTS, events, None, form, count=1 if once else None)
            except TimeoutError:
                return 0

    if run(main()) == 0 and once:
        fail(
            f"no event of {name} within {timeout:g} s: its server or its clients tell of calls only where their "
            "service introspection is switched on (configure_introspection)"
        )


async def _discovered(session: OpenGraph, name: str, spin_time_s: float) -> str:
    """Return the type of the service, or end with a sentence."""
    found = (await settle_services(session.graph, spin_time_s, lambda infos: name in infos)).get(name)
    if found is None:
        fail(f"Unknown service {name!r}; see `ropeway service list`, name its type, or wait longer with --spin-time")
    if len(found.types) != 1:
        fail(f"{name} has several types ({', '.join(found.types)}); name one after the service")
    return found.types[0]
