"""``ropeway topic info``: who publishes and who reads a topic."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, SpinOption, find_topic, open_session, topic_name
from ropeway.graph.base import EndpointInfo, TopicInfo

__all__ = ["app", "endpoint_block", "info_text"]

app = typer.Typer(add_completion=False)


@app.command("info")
def info(
    topic: Annotated[str, typer.Argument(help="The topic, such as /chatter.", show_default=False)],
    graph: GraphOption = "",
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Show nodes, type hashes and QoS.")] = False,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Show the type of TOPIC and count its publishers and subscribers."""
    name = topic_name(topic)

    async def look() -> TopicInfo | None:
        from ropeway.cli.session import settle

        async with open_session(graph) as session:
            if await find_topic(session.graph, name, spin_time) is None:
                return None
            return (await settle(session.graph, spin_time)).get(name)  # the other ends come a moment later

    found = run(look())
    if found is None:
        fail(f"Unknown topic {name!r}; see `ropeway topic list`, or wait longer with --spin-time")
    if as_json:
        print_json(
            {
                "name": found.name,
                "types": found.types,
                "publishers": [_endpoint_json(end) for end in found.publishers if not end.local],
                "subscriptions": [_endpoint_json(end) for end in found.subscriptions if not end.local],
            }
        )
    else:
        answer(info_text(found, verbose=verbose))


def info_text(info: TopicInfo, *, verbose: bool = False) -> str:
    """Return the lines of ``ros2 topic info``; ``verbose`` adds a block for each endpoint."""
    gap = "\n\n" if verbose else "\n"
    parts = [f"Type: {info.types[0] if len(info.types) == 1 else list(info.types)}"]
    for noun, ends in (("Publisher", info.publishers), ("Subscription", info.subscriptions)):
        others = [end for end in ends if not end.local]
        parts.append(f"{noun} count: {len(others)}")
        if verbose:
            parts.extend(endpoint_block(end) for end in others)
    return gap.join(parts)


def endpoint_block(end: EndpointInfo) -> str:
    """Describe a publisher or subscription as ``ros2 topic info -v`` does, with its gateway if it has one."""
    namespace, _, node = end.node.rpartition("/")
    qos = end.qos
    depth = f" ({qos.depth})" if qos.history == "keep_last" else ""
    history = f"{qos.history.upper()}{depth}" if qos.depth else "UNKNOWN"
    lines = [
        f"Node name: {node or '_NODE_NAME_UNKNOWN_'}",
        f"Node namespace: {(namespace or '/') if node else '_NODE_NAMESPACE_UNKNOWN_'}",
        f"Topic type: {end.type}",
        f"Topic type hash: {end.type_hash or 'INVALID'}",
        f"Endpoint type: {end.kind.upper()}",
        f"GID: {'.'.join(f'{byte:02x}' for byte in end.gid)}",
        "QoS profile:",
        f"  Reliability: {qos.reliability.upper()}",
        f"  History (Depth): {history}",
        f"  Durability: {qos.durability.upper()}",
        f"  Lifespan: {_duration(qos.lifespan_s)}",
        f"  Deadline: {_duration(qos.deadline_s)}",
    ]
    if end.gateway:
        lines.append(f"Gateway: {end.gateway}")
    return "\n".join(lines)


def _duration(seconds: float | None) -> str:
    return "Infinite" if seconds is None else f"{round(seconds * 1e9)} nanoseconds"


def _endpoint_json(end: EndpointInfo) -> dict[str, Any]:
    return {
        "node": end.node,
        "type": end.type,
        "type_hash": end.type_hash,
        "gid": end.gid.hex(),
        "gateway": end.gateway,
        "qos": end.qos.to_json(),
    }
