"""``ropeway param delete``: delete a parameter."""

from __future__ import annotations

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.param.common import NameArgument, NodeArgument, TimeoutOption, ask
from ropeway.cli.param.source import parameters_of, place_name
from ropeway.cli.session import GraphOption, JsonOption, OpenGraph

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("delete")
def delete(
    node: NodeArgument,
    name: NameArgument,
    graph: GraphOption = "",
    timeout: TimeoutOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Delete the parameter NAME of NODE."""
    full = place_name(node)

    async def work(session: OpenGraph) -> str | None:
        return (await parameters_of(session, full, timeout).delete([name]))[name]

    refused = ask(graph, full, timeout, work)
    if as_json:
        print_json({"node": full, "name": name, "deleted": refused is None, "reason": refused or ""})
    if refused is not None:
        fail(f"deleting {name} of {full} failed: {refused or 'no reason'}")
    if not as_json:
        answer("Deleted parameter successfully")
