"""``ropeway topic find``: the topics of a type."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.listing import CountOption
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, open_session, settle
from ropeway.cli.topic.list_ import hidden
from ropeway.graph.base import TopicInfo
from ropeway.types.definition import canonical_name

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("find")
def find_topics(
    type: Annotated[str, typer.Argument(help="The type, such as std_msgs/msg/String.", show_default=False)],
    graph: GraphOption = "",
    count: CountOption = False,
    include_hidden: Annotated[
        bool, typer.Option("--include-hidden-topics", help="Show names with a part that starts with _.")
    ] = False,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """List the topics of TYPE."""
    wanted = canonical_name(type)

    async def look() -> dict[str, TopicInfo]:
        async with open_session(graph) as session:
            return await settle(session.graph, spin_time)

    topics = run(look())
    found = [
        name for name, info in sorted(topics.items()) if wanted in info.types and (include_hidden or not hidden(name))
    ]
    if as_json:
        print_json([{"name": name, "types": topics[name].types} for name in found])
    elif count:
        answer(str(len(found)))
    else:
        for name in found:
            answer(name)
