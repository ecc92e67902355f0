"""``ropeway node info``: the topics, services and actions of a node."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, full_name, open_session, settle_nodes
from ropeway.cli.topic.list_ import hidden
from ropeway.graph.base import NodeInfo
from ropeway.graph.calls import ActionInfo

__all__ = ["app", "info_text", "sections"]

app = typer.Typer(add_completion=False)

Pairs = list[tuple[str, str]]


def sections(node: NodeInfo, actions: Mapping[str, ActionInfo], *, include_hidden: bool = False) -> dict[str, Pairs]:
    """Return name and type of what a node uses, under the titles of ``ros2 node info``."""

    def shown(pairs: Iterable[tuple[str, str]]) -> Pairs:
        return sorted(pair for pair in pairs if include_hidden or not hidden(pair[0]))

    found = actions.values()
    return {
        "Subscribers": shown(node.subscriptions),
        "Publishers": shown(node.publishers),
        "Service Servers": shown(node.services),
        "Service Clients": shown(node.clients),
        "Action Servers": shown((a.name, a.type) for a in found if any(end.node == node.name for end in a.servers)),
        "Action Clients": shown((a.name, a.type) for a in found if any(end.node == node.name for end in a.clients)),
    }


def info_text(name: str, parts: Mapping[str, Pairs]) -> str:
    """Return the lines of ``ros2 node info``."""
    blocks = []
    for title, pairs in parts.items():
        blocks.append("\n".join([f"  {title}:", *(f"    {one}: {type}" for one, type in pairs)]))
    gap = "\n"
    return gap.join([name, *(block + ("\n" if block.endswith(":") else "") for block in blocks)])


@app.command("info")
def info(
    node: Annotated[str, typer.Argument(help="The node, such as /talker.", show_default=False)],
    graph: GraphOption = "",
    include_hidden: Annotated[
        bool, typer.Option("--include-hidden", help="Show names with a part that starts with _.")
    ] = False,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Show the topics, services and actions of NODE."""
    name = full_name(node)

    async def look() -> dict[str, Pairs] | None:
        async with open_session(graph) as session:
            found = await settle_nodes(session.graph, spin_time, lambda nodes: name in nodes)
            if name in found:
                found = await settle_nodes(session.graph, spin_time)  # what it uses comes a moment later
            if name not in found:
                return None
            return sections(found[name], session.graph.actions(), include_hidden=include_hidden)

    parts = run(look())
    if parts is None:
        fail(f"Unknown node {name!r}; see `ropeway node list`, or wait longer with --spin-time")
    if as_json:
        listed = {
            title.lower().replace(" ", "_"): [{"name": one, "type": type} for one, type in pairs]
            for title, pairs in parts.items()
        }
        print_json({"name": name, **listed})
    else:
        answer(info_text(name, parts))
