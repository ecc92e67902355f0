"""``ropeway lifecycle get``: the state of a managed node, or of all."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from ropeway.cli.console import answer, complain, print_json
from ropeway.cli.lifecycle.common import TimeoutOption, ask, call, managed
from ropeway.cli.session import GraphOption, JsonOption, OpenGraph, SpinOption, full_name, settle_services
from ropeway.errors import CallError

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("get")
def get(
    node: Annotated[str, typer.Argument(metavar="[NODE]", help="Default: all.", show_default=False)] = "",
    graph: GraphOption = "",
    timeout: TimeoutOption = 5.0,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Show the state of NODE, or of all managed nodes."""
    wanted = full_name(node) if node else ""

    async def state(session: OpenGraph, name: str) -> dict[str, Any]:
        current = (await call(session, name, "get_state", "GetState", timeout))["current_state"]
        return {"node": name, "state": current["label"], "id": int(current["id"])}

    async def work(session: OpenGraph) -> list[dict[str, Any]]:
        if wanted:
            return [await state(session, wanted)]
        found = []
        for name in managed(await settle_services(session.graph, spin_time)):
            try:
                found.append(await state(session, name))
            except CallError as error:  # the others can be told all the same
                complain(f"{name}: {error}")
        return found

    for one in ask(graph, wanted, timeout, work):
        if as_json:
            print_json(one)
        else:
            answer(f"{'' if wanted else one['node'] + ': '}{one['state']} [{one['id']}]")
