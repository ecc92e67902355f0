"""Asks the services of managed nodes (lifecycle_msgs), which all verbs on them do."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Mapping
from typing import Annotated, Any, Final, TypeVar

import typer

from ropeway.cli.asking_node import ask_node
from ropeway.cli.patience import served_within
from ropeway.cli.session import OpenGraph
from ropeway.graph.calls import Request, ServiceInfo

__all__ = ["GET_STATE", "NodeArgument", "TimeoutOption", "ask", "call", "managed"]

T = TypeVar("T")

GET_STATE: Final = "lifecycle_msgs/srv/GetState"

NodeArgument = Annotated[str, typer.Argument(help="The node, such as /lc_talker.", show_default=False)]
TimeoutOption = Annotated[float, typer.Option("--timeout", min=0.001, help="Seconds to wait for the node.")]


def managed(services: Mapping[str, ServiceInfo]) -> list[str]:
    """Return the nodes that tell their state: those with a service ``~/get_state``."""
    return sorted(
        name.removesuffix("/get_state")
        for name, info in services.items()
        if name.endswith("/get_state") and GET_STATE in info.types and any(not end.local for end in info.servers)
    )


async def call(
    session: OpenGraph, node: str, service: str, type: str, timeout_s: float, values: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Call a service of lifecycle_msgs at a node; return its response. Raises ``CallError``."""
    full = f"lifecycle_msgs/srv/{type}"
    asked, read = session.registry.codec(f"{full}_Request"), session.registry.codec(f"{full}_Response")
    client = await session.graph.create_client(f"{node}/{service}", full)
    try:
        left_s = await served_within(client, timeout_s)
        request = Request(asked.from_json(dict(values or {})), caller="ropeway lifecycle")
        return dict(read.decode(await client.call(request, left_s)))
    finally:
        await client.close()


def ask(graph: str, node: str, timeout_s: float, work: Callable[[OpenGraph], Coroutine[Any, Any, T]]) -> T:
    """Run ``work`` on the graph at the URL; a node that does not answer ends with a sentence."""
    return ask_node(graph, node, timeout_s, work, lacking="is not a managed one", listing="lifecycle nodes")
