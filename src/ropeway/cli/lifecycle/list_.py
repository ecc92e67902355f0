"""``ropeway lifecycle list``: the transitions that a managed node can make."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.lifecycle.common import NodeArgument, TimeoutOption, ask, call
from ropeway.cli.session import GraphOption, JsonOption, OpenGraph, full_name

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("list")
def list_transitions(
    node: NodeArgument,
    graph: GraphOption = "",
    every: Annotated[
        bool, typer.Option("--all", "-a", help="Those of all states, not only of the current one.")
    ] = False,
    timeout: TimeoutOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """List the transitions that NODE can make now."""
    full = full_name(node)
    service = "get_transition_graph" if every else "get_available_transitions"

    async def work(session: OpenGraph) -> list[dict[str, Any]]:
        told = await call(session, full, service, "GetAvailableTransitions", timeout)
        return [
            {
                "transition": one["transition"]["label"],
                "id": int(one["transition"]["id"]),
                "start": one["start_state"]["label"],
                "goal": one["goal_state"]["label"],
            }
            for one in told["available_transitions"]
        ]

    found = ask(graph, full, timeout, work)
    if as_json:
        print_json(found)
        return
    for one in found:
        answer(f"- {one['transition']} [{one['id']}]\n\tStart: {one['start']}\n\tGoal: {one['goal']}")
