"""``ropeway param list``: the parameters of a node, or of all nodes."""

from __future__ import annotations

import asyncio
from typing import Annotated, Final

import typer

from ropeway import aio
from ropeway.cli.console import answer, complain, fail, print_json
from ropeway.cli.param.common import TimeoutOption, ask
from ropeway.cli.param.source import AtMaster, parameters_of, place_name
from ropeway.cli.session import (
    GraphOption,
    JsonOption,
    OpenGraph,
    SpinOption,
    settle_services,
)
from ropeway.errors import CallError
from ropeway.graph.parameter_server import ParameterServer
from ropeway.graph.parameters import nodes_with_parameters

__all__ = ["app", "list_all"]

app = typer.Typer(add_completion=False)

_AT_A_TIME: Final = 8  # nodes that are asked at a time

Listed = dict[str, dict[str, str]]


async def list_one(
    session: OpenGraph, node: str, prefixes: list[str], timeout_s: float, *, types: bool
) -> dict[str, str]:
    """Return the names of a node's parameters with their types, which are ``""`` unless ``types``.

    Raises ``CallError``.
    """
    asked = parameters_of(session, node, timeout_s)
    names = await asked.list(prefixes)
    if not types or isinstance(asked, AtMaster):  # which tells no types
        return dict.fromkeys(names, "")
    found = await asked.describe(names)
    return {name: one.type.label if one is not None else "" for name, one in found.items()}


async def list_all(
    session: OpenGraph, prefixes: list[str], timeout_s: float, spin_time_s: float, *, types: bool
) -> tuple[Listed, dict[str, str]]:
    """Return the parameters of all nodes, and why some nodes did not list theirs."""
    if isinstance(session.graph, ParameterServer):
        return {"/": await list_one(session, "/", prefixes, timeout_s, types=False)}, {}
    nodes = nodes_with_parameters(await settle_services(session.graph, spin_time_s))
    turn = asyncio.Semaphore(_AT_A_TIME)
    listed: Listed = {}
    silent: dict[str, str] = {}

    async def one(node: str) -> None:
        async with turn:
            try:
                listed[node] = await list_one(session, node, prefixes, timeout_s, types=types)
            except CallError as error:
                silent[node] = str(error)

    async with aio.TaskGroup() as group:
        for node in nodes:
            group.create_task(one(node))
    return dict(sorted(listed.items())), silent


@app.command("list")
def list_command(
    node: Annotated[str, typer.Argument(help="The node; without it, all nodes.", show_default=False)] = "",
    graph: GraphOption = "",
    prefixes: Annotated[
        list[str] | None, typer.Option("--param-prefixes", help="Only names below this one.", show_default=False)
    ] = None,
    show_types: Annotated[bool, typer.Option("--param-type", help="Show the types too.")] = False,
    spin_time: SpinOption = 2.0,
    timeout: TimeoutOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """List the parameters of NODE, or of all nodes."""
    name = place_name(node) if node else ""

    async def look(session: OpenGraph) -> tuple[Listed, dict[str, str]]:
        if name:
            return {name: await list_one(session, name, prefixes or [], timeout, types=show_types)}, {}
        return await list_all(session, prefixes or [], timeout, spin_time, types=show_types)

    listed, silent = ask(graph, name, timeout, look)
    if as_json:
        for one, found in listed.items():
            names = [{"name": n, "type": t} for n, t in found.items()] if show_types else list(found)
            print_json({"node": one, "parameters": names})
    else:
        for one, found in listed.items():
            lines = [] if name else [f"{one}:"]
            lines.extend(f"  {n} (type: {t})" if t else f"  {n}" for n, t in found.items())
            if lines:
                answer("\n".join(lines))
    for one, why in silent.items():
        complain(f"ropeway: the parameters of {one} could not be listed: {why}")
    if silent and not listed:
        fail("no node listed its parameters; wait longer with --timeout")
