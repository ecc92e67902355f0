"""``ropeway topic list``: the topics there are."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, open_session, settle
from ropeway.graph.base import TopicInfo

__all__ = ["app", "hidden", "verbose_lines"]

app = typer.Typer(add_completion=False)


def hidden(name: str) -> bool:
    """Return whether ROS hides the name: a part starts with an underscore."""
    return any(part.startswith("_") for part in name.split("/"))


def verbose_lines(topics: Iterable[TopicInfo]) -> str:
    """Count publishers and subscriptions, in the lines of ``ros2 topic list -v``."""
    known = list(topics)
    blocks = []
    for title, noun, ends in (
        ("Published", "publisher", [(t, t.publishers) for t in known]),
        ("Subscribed", "subscriber", [(t, t.subscriptions) for t in known]),
    ):
        lines = [f"{title} topics:"]
        for info, there in ends:
            count = sum(not end.local for end in there)
            if count:
                plural = "s" if count > 1 else ""
                lines.append(f" * {info.name} [{', '.join(info.types)}] {count} {noun}{plural}")
        blocks.append("\n".join(lines) + "\n")
    return "\n".join(blocks)


@app.command("list")
def list_topics(
    graph: GraphOption = "",
    show_types: Annotated[bool, typer.Option("--show-types", "-t", help="Show the types too.")] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Count publishers and subscribers.")] = False,
    count: Annotated[bool, typer.Option("--count-topics", "-c", help="Print only how many there are.")] = False,
    include_hidden: Annotated[
        bool, typer.Option("--include-hidden-topics", help="Show names with a part that starts with _.")
    ] = False,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """List the topics."""

    async def look() -> dict[str, TopicInfo]:
        async with open_session(graph) as session:
            return await settle(session.graph, spin_time)

    topics = [info for name, info in sorted(run(look()).items()) if include_hidden or not hidden(name)]
    if as_json:
        print_json(
            [
                {
                    "name": info.name,
                    "types": info.types,
                    "publishers": sum(not end.local for end in info.publishers),
                    "subscriptions": sum(not end.local for end in info.subscriptions),
                }
                for info in topics
            ]
        )
    elif count:
        answer(str(len(topics)))
    elif verbose:
        answer(verbose_lines(topics))
    else:
        for info in topics:
            answer(f"{info.name} [{', '.join(info.types)}]" if show_types else info.name)
