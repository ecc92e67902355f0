"""``ropeway topic type``: the type of a topic."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, find_topic, open_session, topic_name
from ropeway.graph.base import TopicInfo

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("type")
def type_of_topic(
    topic: Annotated[str, typer.Argument(help="The topic, such as /chatter.", show_default=False)],
    graph: GraphOption = "",
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Show the type of TOPIC."""
    name = topic_name(topic)

    async def look() -> TopicInfo | None:
        async with open_session(graph) as session:
            return await find_topic(session.graph, name, spin_time)

    found = run(look())
    if found is None:
        fail(f"Unknown topic {name!r}; see `ropeway topic list`, or wait longer with --spin-time")
    if as_json:
        print_json({"name": name, "types": found.types})
    else:
        answer("\n".join(found.types))
