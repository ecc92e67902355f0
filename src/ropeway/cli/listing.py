"""Provides what ``list``, ``info`` and ``find`` of services and actions share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Annotated, Any, Protocol, TypeVar

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.session import open_session
from ropeway.cli.topic.list_ import hidden
from ropeway.graph.base import Graph
from ropeway.graph.calls import ActionInfo, ProviderInfo, ServiceInfo

__all__ = [
    "CountOption",
    "ShowTypesOption",
    "count_of_others",
    "find_all",
    "find_one",
    "info_json",
    "print_list",
    "print_types",
]

Info = TypeVar("Info", ServiceInfo, ActionInfo)

ShowTypesOption = Annotated[bool, typer.Option("--show-types", "-t", help="Show the types too.")]
CountOption = Annotated[bool, typer.Option("--count", "-c", help="Print only how many there are.")]


class Settle(Protocol[Info]):
    """Waits for what is discovered; ``settle_services`` and ``settle_actions`` do so."""

    async def __call__(
        self, graph: Graph, spin_time_s: float, done: Callable[[dict[str, Info]], bool] | None = None
    ) -> dict[str, Info]:
        """Return what others serve or use."""
        ...


async def find_all(settle: Settle[Info], graph: str, spin_time_s: float) -> Iterable[Info]:
    """Return the services or actions on the graph at the URL ``graph``."""
    async with open_session(graph) as session:
        return (await settle(session.graph, spin_time_s)).values()


async def find_one(
    settle: Settle[Info], kind: str, graph: str, name: str, spin_time_s: float, *, whole: bool = False
) -> Info:
    """Return a service or an action (``kind``), or exit with a sentence; ``whole`` waits for all its endpoints."""
    async with open_session(graph) as session:
        found = await settle(session.graph, spin_time_s, lambda infos: name in infos)
        if whole and name in found:
            found = await settle(session.graph, spin_time_s)
    if name not in found:
        fail(f"Unknown {kind} {name!r}; see `ropeway {kind} list`, or wait longer with --spin-time")
    return found[name]


def count_of_others(ends: Iterable[ProviderInfo]) -> int:
    """Return how many there are besides ours."""
    return sum(not end.local for end in ends)


def print_list(
    infos: Iterable[ServiceInfo | ActionInfo], *, show_types: bool, count: bool, include_hidden: bool, as_json: bool
) -> None:
    """Print the names, in order, as the options ask for them."""
    shown = [info for info in sorted(infos, key=lambda info: info.name) if include_hidden or not hidden(info.name)]
    if as_json:
        print_json(
            [
                {
                    "name": info.name,
                    "types": info.types,
                    "servers": count_of_others(info.servers),
                    "clients": count_of_others(info.clients),
                }
                for info in shown
            ]
        )
    elif count:
        answer(str(len(shown)))
    else:
        for info in shown:
            answer(f"{info.name} [{', '.join(info.types)}]" if show_types else info.name)


def print_types(info: ServiceInfo | ActionInfo, *, as_json: bool) -> None:
    """Print the types of a service or an action."""
    if as_json:
        print_json({"name": info.name, "types": info.types})
    else:
        answer("\n".join(info.types))


def info_json(info: ServiceInfo | ActionInfo) -> dict[str, Any]:
    """Return a service or action with its providers and users as JSON, ours left out."""
    return {
        "name": info.name,
        "types": info.types,
        "servers": [_end(end) for end in info.servers if not end.local],
        "clients": [_end(end) for end in info.clients if not end.local],
    }


def _end(end: ProviderInfo) -> dict[str, str]:
    return {"node": end.node, "gateway": end.gateway}
