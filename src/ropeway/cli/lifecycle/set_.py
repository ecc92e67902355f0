"""``ropeway lifecycle set``: change the state of a managed node."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.lifecycle.common import NodeArgument, TimeoutOption, ask, call
from ropeway.cli.session import GraphOption, JsonOption, OpenGraph, full_name

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("set")
def set_state(
    node: NodeArgument,
    transition: Annotated[
        str, typer.Argument(help="Such as configure, activate, deactivate, cleanup, shutdown; or its number.")
    ],
    graph: GraphOption = "",
    timeout: TimeoutOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Let NODE make TRANSITION; exit status 1 if it does not."""
    full = full_name(node)

    async def work(session: OpenGraph) -> tuple[str, bool]:
        told = await call(session, full, "get_available_transitions", "GetAvailableTransitions", timeout)
        known = {one["transition"]["label"]: int(one["transition"]["id"]) for one in told["available_transitions"]}
        labels = {str(number): label for label, number in known.items()}
        label = labels.get(transition, transition)
        if label not in known:
            possible = ", ".join(f"{name} [{number}]" for name, number in known.items()) or "none"
            fail(f"{full} cannot make the transition {transition} now; possible are: {possible}")
        wanted = {"transition": {"id": known[label], "label": label}}
        answered = await call(session, full, "change_state", "ChangeState", timeout, wanted)
        return label, bool(answered["success"])

    label, done = ask(graph, full, timeout, work)
    if as_json:
        print_json({"node": full, "transition": label, "success": done})
    if not done:
        fail(f"the transition {label} of {full} failed; its log says why, `ropeway lifecycle get {full}` where it is")
    if not as_json:
        answer("Transitioning successful")
