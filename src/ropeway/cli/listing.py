"""Provides what ``list``, ``info`` and ``find`` of services and actions share."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.topic.list_ import hidden
from ropeway.graph.calls import ActionInfo, ProviderInfo, ServiceInfo

__all__ = ["CountOption", "ShowTypesOption", "count_of_others", "info_json", "print_list"]

ShowTypesOption = Annotated[bool, typer.Option("--show-types", "-t", help="Show the types too.")]
CountOption = Annotated[bool, typer.Option("--count", "-c", help="Print only how many there are.")]


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
